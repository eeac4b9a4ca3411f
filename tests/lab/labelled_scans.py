"""Single scans of many places with the true class of every point: what the lidar's tables are measured on.

Every scan has its own layout and pose, all drawn from the seed and the scan's
number: the robot stands still, as if the scan were deskewed already. In every
other scan it is caught in mid-gait, rolled and pitched by about two degrees.
On the uniform slopes it stands parallel to the ground in two scans of four,
and holds its body level with its legs in the other two.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import UnknownName
from quadlog.geometry import apply_transform, transform_from_rpy
from quadlog.lidar import classified_scan as points
from quadlog.messages import Float, Int
from quadlog.simulation.robot.height_field import FLAT, Extent, HeightField, slope, undulating
from quadlog.simulation.sensors.lidar import Lidar, SimulatedScan, SweepScene, TruePointClass, sweep
from quadlog.simulation.sensors.scene import Box, Cylinder, Obstacle, RayCaster
from quadlog.simulation.sensors.trajectory import ROBOT_FEET_M, Motion, OnTerrain, Walk
from quadlog.simulation.synthetic import corridor, forest

_GAIT_TILT_STD_RAD = float(np.deg2rad(2.0))
_BAND_M, _CORRELATION_M, _HALF_WIDTH_M = 0.12, 1.0, 25.0
_RAMP_RUN_M = 4.0
# Nothing stands nearer to the robot than it could have walked.
_NEAREST_M, _FARTHEST_M = 1.2, 18.0


@dataclass(frozen=True, slots=True)
class Standing:
    """At one place of map all the time, tilted or level."""

    x_m: float
    y_m: float
    yaw_rad: float
    roll_rad: float = 0.0
    pitch_rad: float = 0.0

    def at(self, t_s: Float) -> Motion:
        """See Walk."""
        place_m = np.tile([self.x_m, self.y_m], (len(t_s), 1))
        pose = (self.yaw_rad, 0.0, 0.0, 0.0, 0.0, self.roll_rad, self.pitch_rad)
        return Motion(place_m, *(np.full(len(t_s), value) for value in pose))


@dataclass(frozen=True, slots=True)
class ScanSite:
    """The ground, what stands on it, who stands there, and the robot: all of them still."""

    terrain: HeightField
    obstacles: tuple[Obstacle, ...]
    people: tuple[Walk, ...]
    robot: Walk


def ramp(angle_rad: float, start_m: float, run_m: float) -> HeightField:
    """Flat, then up from x = start_m over run_m of x, then flat again."""
    heights = np.tile(run_m * np.tan(angle_rad) * np.array([0.0, 0.0, 1.0, 1.0]), (3, 1))
    return HeightField(heights.astype(np.float32), run_m, (start_m - run_m, -run_m))


def _open_ground(rng: np.random.Generator, index: int) -> ScanSite:
    return _scattered(rng, FLAT, _anywhere(rng, index))


def _undulating(rng: np.random.Generator, index: int) -> ScanSite:
    extent = Extent(*(by_m * _HALF_WIDTH_M for by_m in (-1, -1, 1, 1)))
    terrain = undulating(_BAND_M, _CORRELATION_M, rng, extent, _CORRELATION_M / 5, fade_m=3.0)
    return _scattered(rng, terrain, OnTerrain(_anywhere(rng, index), terrain, ROBOT_FEET_M))


def _ramp(angle_deg: float, rng: np.random.Generator, index: int) -> ScanSite:
    """The robot on the flat, 1.5 to 4 m before the foot of the ramp, looking up it."""
    terrain = ramp(np.deg2rad(angle_deg), float(rng.uniform(1.5, 4.0)), _RAMP_RUN_M)
    return _scattered(rng, terrain, _robot(rng, index, np.zeros(2), float(rng.uniform(-0.4, 0.4))))


def _slope(angle_deg: float, rng: np.random.Generator, index: int) -> ScanSite:
    """Any way round on a slope; see labelled_scans for how the robot stands on it."""
    terrain = slope(np.deg2rad(angle_deg))
    parallel = index % 4 < 2
    return _scattered(rng, terrain, OnTerrain(_anywhere(rng, index), terrain, ROBOT_FEET_M if parallel else None))


def _corridor(rng: np.random.Generator, index: int) -> ScanSite:
    """Anywhere along the corridor, up to 0.3 m off its middle, the person 1.5 to 3 m ahead."""
    way = corridor.route()
    along_m, aside_m, askew_rad = rng.uniform([0.0, -0.3, -0.3], [way.length_m, 0.3, 0.3]).tolist()
    (here_m, ahead_m), heading_rad, _ = way.at(np.array([along_m, along_m + rng.uniform(1.5, 3.0)]))
    left = np.array([-np.sin(heading_rad[0]), np.cos(heading_rad[0])])
    place_m = here_m + aside_m * left
    robot = _robot(rng, index, place_m, float(heading_rad[0]) + askew_rad)
    person = _standing(ahead_m, float(heading_rad[1]))
    boxes = [each for each in corridor.cartons(rng) if np.linalg.norm(place_m - [each.x_m, each.y_m]) > _NEAREST_M]
    return ScanSite(FLAT, (*corridor.building(), *boxes), (person,), robot)


def _wall_ahead(rng: np.random.Generator, index: int) -> ScanSite:
    """A wall across the way, 1.5 to 4 m ahead, on flat ground with things about."""
    away_m, askew_rad, aside_m = rng.uniform([1.5, -0.25, -1.5], [4.0, 0.25, 1.5]).tolist()
    wide_m, high_m = rng.uniform([6.0, 2.0], [14.0, 3.5]).tolist()
    wall = Box(away_m + 0.1, aside_m, 0.2, wide_m, high_m, askew_rad)
    # The robot faces +x; what stands, stands behind it.
    place = _scattered(rng, FLAT, _robot(rng, index, np.zeros(2), 0.0), between_rad=(2.0, 2 * np.pi - 2.0))
    return ScanSite(place.terrain, (wall, *place.obstacles), (), place.robot)


def _forest(rng: np.random.Generator, index: int) -> ScanSite:
    """On the way through a forest of its own, the person 2 m ahead."""
    grown = forest.grow(rng)
    along_m = float(rng.uniform(0.0, grown.route.length_m))
    (here_m, ahead_m), heading_rad, _ = grown.route.at(np.array([along_m, along_m + forest.GAP_M]))
    robot = _robot(rng, index, here_m, float(heading_rad[0]))
    person = OnTerrain(_standing(ahead_m, float(heading_rad[1])), grown.terrain)
    on_ground = OnTerrain(robot, grown.terrain, ROBOT_FEET_M)
    return ScanSite(grown.terrain, (*grown.trunks, *grown.foliage), (person,), on_ground)


PLACES: dict[str, Callable[[np.random.Generator, int], ScanSite]] = {
    "flat": _open_ground,
    "undulating": _undulating,
    "ramp_15": partial(_ramp, 15.0),
    "ramp_20": partial(_ramp, 20.0),
    "slope_15": partial(_slope, 15.0),
    "slope_20": partial(_slope, 20.0),
    "corridor": _corridor,
    "wall_ahead": _wall_ahead,
    "forest": _forest,
}


def _robot(rng: np.random.Generator, index: int, place_m: Float, yaw_rad: float) -> Standing:
    """In every other scan in mid-gait."""
    roll_rad, pitch_rad = (rng.normal(0.0, _GAIT_TILT_STD_RAD, 2) * (index % 2)).tolist()
    return _standing(place_m, yaw_rad, roll_rad, pitch_rad)


def _standing(place_m: Float, yaw_rad: float, roll_rad: float = 0.0, pitch_rad: float = 0.0) -> Standing:
    x_m, y_m = place_m.tolist()
    return Standing(x_m, y_m, yaw_rad, roll_rad, pitch_rad)


def _anywhere(rng: np.random.Generator, index: int) -> Standing:
    return _robot(rng, index, rng.uniform(-5.0, 5.0, 2), float(rng.uniform(-np.pi, np.pi)))


def _scattered(
    rng: np.random.Generator, terrain: HeightField, robot: Walk, between_rad: tuple[float, float] = (-np.pi, np.pi)
) -> ScanSite:
    """Boxes, poles and trees round the robot, and a person ahead of it, anywhere between two bearings of map."""
    motion = robot.at(np.zeros(1))
    here_m, yaw_rad = motion.position_m[0], float(motion.yaw_rad[0])

    def somewhere(reach_m: float) -> tuple[float, float]:
        away_m, bearing_rad = rng.uniform(_NEAREST_M + reach_m, _FARTHEST_M), rng.uniform(*between_rad)
        return float(here_m[0] + away_m * np.cos(bearing_rad)), float(here_m[1] + away_m * np.sin(bearing_rad))

    made: list[Obstacle] = []
    for _ in range(int(rng.integers(5, 10))):
        made.append(Box(*somewhere(0.9), *rng.uniform([0.2, 0.2, 0.15, -np.pi], [1.5, 1.0, 1.5, np.pi]).tolist()))
    for _ in range(int(rng.integers(3, 7))):
        made.append(Cylinder(*somewhere(0.1), *rng.uniform([0.03, 1.0], [0.08, 3.0]).tolist()))
    for _ in range(int(rng.integers(4, 9))):
        made.append(Cylinder(*somewhere(0.4), *rng.uniform([0.1, 3.5], [0.35, 6.0]).tolist()))
    ahead_m = rng.uniform(1.5, 3.0)
    person_m = here_m + ahead_m * np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
    return ScanSite(terrain, tuple(made), (OnTerrain(_standing(person_m, yaw_rad), terrain),), robot)


SCANS_LIDAR = Lidar(dropout_share=0.0, false_share=0.01)
"""16 beams of 1875 steps, 2 cm noise; 1 % of the returns are false: `Lidar` says how they are drawn."""

_MOUNT_HEIGHT_M = (0.4, 0.5)
_TRUTH = {
    TruePointClass.GROUND: points.PointClass.GROUND,
    TruePointClass.OBSTACLE: points.PointClass.OBSTACLE,
    TruePointClass.PERSON: points.PointClass.OBSTACLE,
    TruePointClass.PASSER_BY: points.PointClass.OBSTACLE,
    TruePointClass.FALSE: points.PointClass.OUTLIER,
}


@dataclass(frozen=True, slots=True)
class LabelledScan:
    """One scan of N points, as a driver sends them, column by column and each column bottom up, and its truth.

    xyz_lidar_m: (N, 3) float32; rays without a return are left out.
    ring: (N,) uint16 from 0, the lowest; offset_ns: (N,) relative to the first.
    truth: (N,) uint8 of quadlog.lidar.classified_scan.PointClass: GROUND, OBSTACLE or OUTLIER. A false
    point is an OUTLIER even where its range happens to meet something.
    height_m: (N,) of the true point above the ground right below it, NaN for outliers.
    transform_lidar_to_base: (4, 4) the mount, without the gait's tilt.
    transform_base_to_map: (4, 4) where the robot stands, and its tilt.
    """

    xyz_lidar_m: NDArray[np.float32]
    ring: NDArray[np.uint16]
    offset_ns: Int
    truth: NDArray[np.uint8]
    height_m: Float
    transform_lidar_to_base: Float
    transform_base_to_map: Float


def labelled_scans(name: str, seed: int, n: int) -> Iterator[LabelledScan]:
    """The first n scans of a place of PLACES; scan i does not depend on n. Raises UnknownName."""
    if name not in PLACES:
        raise UnknownName("place", name, PLACES)
    for index in range(n):
        rng = np.random.default_rng([seed, index, *name.encode()])
        yield _scan_at(PLACES[name](rng, index), rng)


def _scan_at(place: ScanSite, rng: np.random.Generator) -> LabelledScan:
    height_m = float(rng.uniform(*_MOUNT_HEIGHT_M))
    mount = transform_from_rpy(np.array([0.0, 0.0, height_m]), 0.0, 0.0, 0.0)
    caster = RayCaster(place.obstacles, place.terrain)
    world = SweepScene(caster, place.robot, tuple((each, TruePointClass.PERSON) for each in place.people), mount)
    # Nothing moves during the scan, so the time does not matter.
    scan = sweep(SCANS_LIDAR, world, start_ns=0, stamp_ns=0, rng=rng)
    pose = _pose(place.robot.at(np.zeros(1)))
    assert scan.cloud.ring is not None
    assert scan.cloud.offset_ns is not None
    return LabelledScan(
        xyz_lidar_m=scan.cloud.xyz_m,
        ring=scan.cloud.ring,
        offset_ns=scan.cloud.offset_ns,
        truth=np.array([_TRUTH[each] for each in TruePointClass], dtype=np.uint8)[scan.point_class],
        height_m=_heights(scan, pose @ mount, place),
        transform_lidar_to_base=mount,
        transform_base_to_map=pose,
    )


def _pose(motion: Motion) -> Float:
    place_m = np.append(motion.position_m[0], motion.height_m[0])
    return transform_from_rpy(place_m, motion.roll_rad[0], motion.pitch_rad[0], motion.yaw_rad[0])


def _heights(scan: SimulatedScan, transform_lidar_to_map: Float, place: ScanSite) -> Float:
    """(N,) heights of the points without their noise above the ground below them, NaN where there is no true point."""
    known = np.isfinite(scan.range_m)
    measured_m = scan.cloud.xyz_m[known].astype(np.float64)
    shrink = scan.range_m[known] / np.linalg.norm(measured_m, axis=1)
    in_map_m = apply_transform(transform_lidar_to_map, measured_m * shrink[:, None])
    height_m = np.full(len(known), np.nan)
    height_m[known] = in_map_m[:, 2] - place.terrain.height_at(in_map_m[:, :2])
    return height_m
