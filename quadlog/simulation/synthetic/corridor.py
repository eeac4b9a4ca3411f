"""The scenario `corridor`: a robot follows a person round the four bends of a corridor that is two metres wide."""

from __future__ import annotations

import numpy as np

from quadlog.messages import Float
from quadlog.simulation.sensors.lidar import Lidar
from quadlog.simulation.sensors.scene import Box, Obstacle
from quadlog.simulation.sensors.trajectory import PacingWalk, Route, RouteWalk
from quadlog.simulation.synthetic.recording import Site, SynthesizedRecording

WIDTH_M = 2.0
OUTER_M = (16.0, 12.0)
"""The corridor runs round a block of rooms, inside the rectangle from (0, 0) to here."""
ANCHORS_M = np.array(
    [
        [0.3, 0.3, 2.3], [15.7, 0.3, 2.2], [15.7, 11.7, 2.35], [0.3, 11.7, 2.25],
        [6.0, 1.9, 2.2], [14.1, 6.6, 2.3], [9.5, 10.1, 2.2], [1.9, 5.0, 2.3],
    ]
)  # fmt: skip
"""In the corners and halfway on the inner walls: from any place the far sides' are behind walls."""

SPEED_MPS = 0.6
GAP_M = 2.1

_INNER_M = (OUTER_M[0] - WIDTH_M, OUTER_M[1] - WIDTH_M)
_WALL_M, _WALL_HEIGHT_M = 0.15, 2.6
_DOOR_WIDTH_M, _DOOR_HEIGHT_M, _LEAF_M = 0.9, 2.1, 0.04
_ROUNDING_M = 0.85
_WAYPOINT_STEP_M = 0.35

Point = tuple[float, float]


def building() -> tuple[Obstacle, ...]:
    """Walls with closed doors set back in them, one room with its door open, and a ceiling."""
    (x1, y1), (x0, y0), (x2, y2) = OUTER_M, (WIDTH_M, WIDTH_M), _INNER_M
    walls = [
        # The outer wall, seen from inside; every wall's stuff lies to the right of its direction.
        *_wall((0.0, 0.0), (x1, 0.0), doors_at_m=(3.0, 12.5)),
        *_wall((x1, 0.0), (x1, y1), doors_at_m=(4.5,)),
        *_wall((x1, y1), (0.0, y1), doors_at_m=(5.5, 11.0)),
        *_wall((0.0, y1), (0.0, 0.0), doors_at_m=(7.0,)),
        # The block in the middle; the last door of its south side stands open.
        *_wall((x2, y0), (x0, y0), doors_at_m=(9.5,), open_at_m=(3.5,)),
        *_wall((x2, y2), (x2, y0), doors_at_m=(5.5,)),
        *_wall((x0, y2), (x2, y2), doors_at_m=(3.0, 10.0)),
        *_wall((x0, y0), (x0, y2), doors_at_m=(6.0,)),
        # The room behind it.
        *_wall((12.5, y0), (12.5, 6.0)),
        *_wall((12.5, 6.0), (8.0, 6.0)),
        *_wall((8.0, 6.0), (8.0, y0)),
    ]
    ceiling = Box(x1 / 2, y1 / 2, x1, y1, _WALL_HEIGHT_M + 0.1, bottom_m=_WALL_HEIGHT_M)
    return (*walls, ceiling)


def cartons(rng: np.random.Generator) -> tuple[Box, ...]:
    """Two or three on each side, pushed against a wall, away from the bends and the open door."""
    made: list[Box] = []
    for side in range(4):
        length_m = OUTER_M[side % 2]
        places_m = np.arange(3.2, length_m - 3.0, 1.6)
        for along_m in rng.choice(places_m, size=int(rng.integers(2, 4)), replace=False).tolist():
            depth_m, wide_m, height_m = rng.uniform([0.25, 0.3, 0.15], [0.45, 0.8, 0.9]).tolist()
            inner = bool(rng.random() < 0.5) and side != 0
            from_wall_m = WIDTH_M - 0.02 - depth_m / 2 if inner else 0.02 + depth_m / 2
            made.append(_beside(side, along_m, from_wall_m, wide_m, depth_m, height_m))
    return tuple(made)


def route() -> Route:
    """The middle of the corridor, once round, to the left."""
    half_m = WIDTH_M / 2
    low, (right, top) = half_m, (OUTER_M[0] - half_m, OUTER_M[1] - half_m)
    corners = [(right, low, -np.pi / 2), (right, top, 0.0), (low, top, np.pi / 2), (low, low, np.pi)]
    turns = []
    for x_m, y_m, first_rad in corners:
        centre_m = np.array(
            [x_m + np.sign(low - x_m + 0.1) * _ROUNDING_M, y_m + np.sign(low - y_m + 0.1) * _ROUNDING_M]
        )
        angle_rad = first_rad + np.linspace(0.0, np.pi / 2, 5)
        turns.append(centre_m + _ROUNDING_M * np.column_stack([np.cos(angle_rad), np.sin(angle_rad)]))
    points_m: list[Float] = []
    for turn, following in zip(turns, [*turns[1:], turns[0]], strict=True):
        steps = int(np.ceil(np.linalg.norm(following[0] - turn[-1]) / _WAYPOINT_STEP_M))
        straight = turn[-1] + np.linspace(0.0, 1.0, steps + 1)[1:-1, None] * (following[0] - turn[-1])
        points_m += [turn, straight]
    return Route(np.concatenate(points_m))


def synthesize(seed: int, duration_s: float, azimuth_steps: int) -> SynthesizedRecording:
    """The recording and its truth; the seed puts the cartons down and draws every error, the building stays.

    duration_s: of any length, the way round is closed; azimuth_steps: of one sweep, 1875 give 30 000 rays.
    """
    way = route()
    site = Site(
        obstacles=(*building(), *cartons(np.random.default_rng([seed, *b"corridor"]))),
        anchors_m=ANCHORS_M,
        robot=RouteWalk(way, 4.0, SPEED_MPS, sway_m=0.15, period_s=13.0),
        person=RouteWalk(way, 4.0 + GAP_M, SPEED_MPS, sway_m=0.1, period_s=9.0),
        passer_by=PacingWalk((9.0, 3.2), (11.6, 4.8), period_s=11.0),
    )
    return SynthesizedRecording(site, seed, duration_s, Lidar(azimuth_steps=azimuth_steps))


def _wall(start: Point, end: Point, doors_at_m: tuple[float, ...] = (), open_at_m: tuple[float, ...] = ()) -> list[Box]:
    """A wall whose face is the line from start to end and whose inside lies to the right, with doors along it."""
    length_m = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    edges_m = [0.0]
    for door_m in sorted([*doors_at_m, *open_at_m]):
        edges_m += [door_m - _DOOR_WIDTH_M / 2, door_m + _DOOR_WIDTH_M / 2]
    edges_m.append(length_m)
    solid = [
        _in_wall(start, end, (first + last) / 2, last - first, _WALL_M, 0.0, _WALL_HEIGHT_M)
        for first, last in zip(edges_m[::2], edges_m[1::2], strict=True)
    ]
    lintels = [
        _in_wall(start, end, door_m, _DOOR_WIDTH_M, _WALL_M, _DOOR_HEIGHT_M, _WALL_HEIGHT_M)
        for door_m in (*doors_at_m, *open_at_m)
    ]
    leaves = [_in_wall(start, end, door_m, _DOOR_WIDTH_M, _LEAF_M, 0.0, _DOOR_HEIGHT_M, 0.1) for door_m in doors_at_m]
    return [*solid, *lintels, *leaves]


def _in_wall(
    start: Point,
    end: Point,
    along_m: float,
    length_m: float,
    thick_m: float,
    bottom_m: float,
    height_m: float,
    back_m: float = 0.0,
) -> Box:
    """A piece of a wall, its middle along_m from start, its face back_m behind the wall's."""
    yaw_rad = float(np.arctan2(end[1] - start[1], end[0] - start[0]))
    behind_m = back_m + thick_m / 2
    x_m = start[0] + along_m * np.cos(yaw_rad) + behind_m * np.sin(yaw_rad)
    y_m = start[1] + along_m * np.sin(yaw_rad) - behind_m * np.cos(yaw_rad)
    return Box(float(x_m), float(y_m), length_m, thick_m, height_m, yaw_rad, bottom_m)


def _beside(side: int, along_m: float, from_wall_m: float, wide_m: float, depth_m: float, height_m: float) -> Box:
    """A box on a side of the ring, 0 the south one and on to the left, from_wall_m off the outer wall."""
    x1, y1 = OUTER_M
    x_m, y_m = (
        (along_m, from_wall_m),
        (x1 - from_wall_m, along_m),
        (x1 - along_m, y1 - from_wall_m),
        (from_wall_m, y1 - along_m),
    )[side]
    return Box(float(x_m), float(y_m), wide_m, depth_m, height_m, side * np.pi / 2)
