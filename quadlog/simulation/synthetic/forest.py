"""The scenario `forest`: a robot follows a person between trees, saplings and low branches, over uneven ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float
from quadlog.simulation.robot.height_field import Extent, HeightField, undulating
from quadlog.simulation.sensors.lidar import Lidar
from quadlog.simulation.sensors.scene import Box, Cylinder, Obstacle
from quadlog.simulation.sensors.trajectory import ROBOT_FEET_M, OnTerrain, PacingWalk, Route, RouteWalk
from quadlog.simulation.synthetic.recording import Site, SynthesizedRecording

CENTRE_M = (14.0, 14.0)
ANCHORS_M = np.array([[4.0, 4.3, 1.6], [24.2, 3.8, 1.9], [23.7, 24.0, 1.7], [4.2, 23.8, 2.0], [11.6, 14.2, 2.3]])
"""Four about the walk and one inside it, on no line with two others; trunks take the sight to some of them."""

SPEED_MPS = 0.7
GAP_M = 2.1

_HALF_WIDTH_M = 18.0
_BAND_M, _CORRELATION_M, _CELL_M, _FADE_M = 0.16, 2.0, 0.4, 3.0
_TREES, _THICKETS = 110, 30
_RADIUS_M = (0.08, 0.35)
_TRIES = 60
# From the middle of the walk to what grows: half a robot's width, and room to sway.
_CLEAR_OF_WALK_M = 0.75
_APART_M = 0.9
_LOW_BRANCH_SHARE = 0.4


@dataclass(frozen=True, slots=True)
class Forest:
    """What a seed grows: trunks stop UWB; crowns, branches and saplings do not."""

    terrain: HeightField
    route: Route
    passer_by: PacingWalk
    trunks: tuple[Cylinder, ...]
    foliage: tuple[Obstacle, ...]


def grow(rng: np.random.Generator) -> Forest:
    """A forest about CENTRE_M; no trunk, branch or sapling comes nearer to the walks than a robot needs."""
    extent = Extent(*(at_m + by_m for by_m in (-_HALF_WIDTH_M, _HALF_WIDTH_M) for at_m in CENTRE_M))
    terrain = undulating(_BAND_M, _CORRELATION_M, rng, extent, _CELL_M, _FADE_M)
    route = _winding_way(rng)
    passer_by = _across(rng)
    walked_m = _walked(route, passer_by)
    trunks: list[Cylinder] = []
    foliage: list[Obstacle] = []
    for _ in range(_TREES):
        radius_m = float(rng.uniform(*_RADIUS_M))
        place = _free_place(rng, radius_m, walked_m, trunks)
        if place is not None:
            trunks.append(Cylinder(*place, radius_m, float(rng.uniform(3.5, 6.0))))
            foliage += _crown_and_branch(rng, trunks[-1], walked_m)
    for _ in range(_THICKETS):
        spread_m = float(rng.uniform(0.15, 0.45))
        place = _free_place(rng, spread_m, walked_m, trunks)
        if place is not None:
            foliage += _saplings(rng, place, spread_m)
    return Forest(terrain, route, passer_by, tuple(trunks), tuple(foliage))


def synthesize(seed: int, duration_s: float, azimuth_steps: int) -> SynthesizedRecording:
    """The recording and its truth; the seed grows the forest and lays the way through it, and draws every error.

    duration_s: of any length, the way round is closed; azimuth_steps: of one sweep, 1875 give 30 000 rays.
    """
    forest = grow(np.random.default_rng([seed, *b"forest"]))
    site = Site(
        obstacles=forest.trunks,
        anchors_m=ANCHORS_M,
        robot=OnTerrain(RouteWalk(forest.route, 0.0, SPEED_MPS, 0.18, 13.0), forest.terrain, ROBOT_FEET_M),
        person=OnTerrain(RouteWalk(forest.route, GAP_M, SPEED_MPS, 0.12, 9.0), forest.terrain),
        passer_by=OnTerrain(forest.passer_by, forest.terrain),
        foliage=forest.foliage,
        terrain=forest.terrain,
    )
    return SynthesizedRecording(site, seed, duration_s, Lidar(azimuth_steps=azimuth_steps))


def _winding_way(rng: np.random.Generator) -> Route:
    """Round the middle, 5 to 10 m from it, a wave for each way of bending."""
    angle_rad = 2 * np.pi * np.arange(48) / 48
    radius_m = np.full(len(angle_rad), 7.5)
    for bends, most_m in ((2, 0.8), (3, 0.6), (5, 0.5), (7, 0.3)):
        radius_m += rng.uniform(0.5, 1.0) * most_m * np.cos(bends * angle_rad + rng.uniform(0, 2 * np.pi))
    return Route(radius_m[:, None] * np.column_stack([np.cos(angle_rad), np.sin(angle_rad)]) + CENTRE_M)


def _across(rng: np.random.Generator) -> PacingWalk:
    """Somebody else walks up and down past the middle."""
    angle_rad = rng.uniform(0, np.pi)
    along = 3.0 * np.array([np.cos(angle_rad), np.sin(angle_rad)])
    aside = 1.5 * np.array([-np.sin(angle_rad), np.cos(angle_rad)]) + CENTRE_M
    (x0, y0), (x1, y1) = (aside - along).tolist(), (aside + along).tolist()
    return PacingWalk((x0, y0), (x1, y1), period_s=15.0)


def _walked(route: Route, passer_by: PacingWalk) -> Float:
    """(N, 2) points that must stay clear: the walks, densely, and the anchors' poles."""
    round_m, _, _ = route.at(np.arange(0.0, route.length_m, 0.1))
    across_m = passer_by.at(np.linspace(0.0, passer_by.period_s / 2, 100)).position_m
    return np.concatenate([round_m, across_m, ANCHORS_M[:, :2]])


def _free_place(
    rng: np.random.Generator, radius_m: float, walked_m: Float, trunks: list[Cylinder]
) -> tuple[float, float] | None:
    """Where something of a radius can grow, or None when all tries fell on the walks or other trees."""
    standing = np.array([[each.x_m, each.y_m, each.radius_m] for each in trunks]).reshape(-1, 3)
    for place_m in rng.uniform(-_HALF_WIDTH_M, _HALF_WIDTH_M, (_TRIES, 2)) + CENTRE_M:
        to_walk_m = np.linalg.norm(walked_m - place_m, axis=1).min()
        to_trunks_m = np.linalg.norm(standing[:, :2] - place_m, axis=1) - standing[:, 2]
        if to_walk_m >= radius_m + _CLEAR_OF_WALK_M and to_trunks_m.min(initial=np.inf) >= radius_m + _APART_M:
            return float(place_m[0]), float(place_m[1])
    return None


def _crown_and_branch(rng: np.random.Generator, trunk: Cylinder, walked_m: Float) -> list[Obstacle]:
    """Above everybody's head a crown; on some trees a branch low enough to be in the way, but not over the walk."""
    crown_m = float(rng.uniform(0.8, 1.6))
    grown: list[Obstacle] = [Cylinder(trunk.x_m, trunk.y_m, crown_m, trunk.height_m + 1.0, bottom_m=trunk.height_m)]
    length_m, yaw_rad, bottom_m = rng.uniform([0.5, -np.pi, 0.4], [1.3, np.pi, 1.6]).tolist()
    out = np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
    middle_m = np.array([trunk.x_m, trunk.y_m]) + out * (trunk.radius_m + length_m / 2)
    reaches_m = length_m / 2 + _CLEAR_OF_WALK_M
    if rng.random() < _LOW_BRANCH_SHARE and np.linalg.norm(walked_m - middle_m, axis=1).min() >= reaches_m:
        x_m, y_m = middle_m.tolist()
        grown.append(Box(x_m, y_m, length_m, 0.04, bottom_m + 0.04, yaw_rad, bottom_m))
    return grown


def _saplings(rng: np.random.Generator, place_m: tuple[float, float], spread_m: float) -> list[Obstacle]:
    """A thicket of stems as thick as fingers and wrists, knee- to breast-high."""
    stems: list[Obstacle] = []
    for _ in range(int(rng.integers(5, 12))):
        away_m, angle_rad = spread_m * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi)
        x_m, y_m = place_m[0] + away_m * np.cos(angle_rad), place_m[1] + away_m * np.sin(angle_rad)
        stems.append(Cylinder(float(x_m), float(y_m), float(rng.uniform(0.01, 0.03)), float(rng.uniform(0.3, 1.3))))
    return stems
