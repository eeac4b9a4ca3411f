"""The scenario `follow`: a robot follows a walking person through a yard with boxes, walls and trees."""

from __future__ import annotations

import numpy as np

from quadlog.simulation.sensors.lidar import Lidar
from quadlog.simulation.sensors.scene import Box, Cylinder, Obstacle
from quadlog.simulation.sensors.trajectory import PacingWalk, Route, RouteWalk
from quadlog.simulation.synthetic.recording import Site, SynthesizedRecording

ANCHORS_M = np.array([[1.0, 1.0, 1.15], [20.0, 1.2, 1.20], [17.5, 15.8, 1.26], [1.2, 14.8, 1.22]])

WAYPOINTS_M = np.array(
    [
        [2.5, 4.2], [4.2, 4.5], [6.0, 5.1], [7.4, 4.6], [8.6, 3.7], [9.6, 4.1], [10.05, 5.3], [10.2, 6.45],
        [10.43, 7.05], [11.0, 7.3], [11.57, 7.05], [11.8, 6.45], [12.0, 5.3], [12.7, 4.0], [14.4, 2.9], [16.6, 3.4],
        [17.8, 5.6], [17.7, 8.0], [17.8, 10.4], [17.0, 12.4], [14.6, 13.2], [12.2, 12.3], [9.8, 12.9], [7.4, 12.1],
        [5.0, 12.9], [3.3, 11.4], [3.2, 9.0], [1.7, 6.8], [1.5, 5.0],
    ]
)  # fmt: skip
"""The way round, in map: past a crate, under a tree, about the end of a wall, through a grove and back."""

OBSTACLES: tuple[Obstacle, ...] = (
    # The yard's own walls, with gaps to the east and the north-west.
    Box(10.5, -0.6, 22.0, 0.3, 3.5),
    Box(-0.6, 6.0, 0.3, 13.0, 3.5),
    Box(13.5, 16.6, 16.0, 0.3, 3.5),
    Box(21.6, 3.4, 0.3, 7.8, 3.5),
    Box(21.6, 13.2, 0.3, 7.0, 3.5),
    # Things to walk around.
    Box(6.0, 3.9, 1.2, 0.8, 0.6, yaw_rad=0.15),
    Box(11.0, 5.45, 0.2, 2.3, 2.0),
    Box(3.0, 0.6, 2.4, 0.9, 1.5),
    Box(14.6, 4.5, 1.4, 0.9, 0.8, yaw_rad=-0.5),
    Box(15.6, 8.4, 1.2, 2.2, 1.0),
    Box(1.2, 9.2, 0.8, 0.8, 0.8),
    Box(8.0, 7.6, 2.0, 0.3, 0.55, yaw_rad=0.25),
    # Trees.
    Cylinder(8.8, 4.75, 0.25, 4.0),
    Cylinder(7.6, 2.4, 0.18, 4.0),
    Cylinder(9.2, 1.2, 0.22, 4.0),
    Cylinder(16.4, 1.0, 0.3, 5.0),
    Cylinder(19.4, 7.3, 0.25, 4.5),
    Cylinder(15.6, 11.6, 0.2, 4.0),
    Cylinder(12.3, 13.4, 0.2, 4.5),
    Cylinder(9.9, 11.4, 0.22, 4.0),
    Cylinder(7.4, 13.4, 0.3, 5.0),
    Cylinder(5.2, 11.4, 0.14, 4.0),
    Cylinder(4.2, 14.8, 0.25, 4.5),
    Cylinder(-3.0, 14.5, 0.4, 6.0),
    Cylinder(24.5, 8.0, 0.4, 6.0),
)

SPEED_MPS = 0.7
PERSON_START_M = 5.4
GAP_M = 2.1


def synthesize(seed: int, duration_s: float, azimuth_steps: int) -> SynthesizedRecording:
    """The recording and its truth; the seed draws every error, the yard and the walk stay the same.

    duration_s: of any length, the way round is closed; azimuth_steps: of one sweep, 1875 give 30 000 rays.
    """
    route = Route(WAYPOINTS_M)
    site = Site(
        obstacles=OBSTACLES,
        anchors_m=ANCHORS_M,
        robot=RouteWalk(route, PERSON_START_M - GAP_M, SPEED_MPS, sway_m=0.18, period_s=13.0),
        person=RouteWalk(route, PERSON_START_M, SPEED_MPS, sway_m=0.12, period_s=9.0),
        passer_by=PacingWalk((6.5, 9.8), (13.4, 9.4), period_s=17.0),
    )
    return SynthesizedRecording(site, seed, duration_s, Lidar(azimuth_steps=azimuth_steps))
