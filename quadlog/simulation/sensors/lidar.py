"""A simulated lidar, sweep by sweep, and a walking person as upright cylinders: trunk, head and legs."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from quadlog.geometry import seconds_since
from quadlog.messages import Float, PointCloud
from quadlog.simulation.sensors.scene import GROUND, NOTHING, RayCaster
from quadlog.simulation.sensors.trajectory import Motion, Walk, position_in_map, turned_into_map

_STRIDE_S = 1.1
_LEG_SWING_M = 0.22


@dataclass(frozen=True, slots=True)
class BodyPart:
    """An upright cylinder between two heights; left_m is its place across the body, swing_m how far it swings."""

    radius_m: float
    low_m: float
    high_m: float
    left_m: float = 0.0
    swing_m: float = 0.0


BODY = (
    BodyPart(radius_m=0.2, low_m=0.8, high_m=1.48),
    BodyPart(radius_m=0.1, low_m=1.48, high_m=1.72),
    BodyPart(radius_m=0.08, low_m=0.0, high_m=0.8, left_m=0.1, swing_m=_LEG_SWING_M),
    BodyPart(radius_m=0.08, low_m=0.0, high_m=0.8, left_m=-0.1, swing_m=-_LEG_SWING_M),
)


def part_centres(walk: Walk, t_s: Float) -> Float:
    """(N, parts, 2) centres of the body's cylinders in map at t_s (N,)."""
    motion = walk.at(t_s)
    swing = np.sin(2 * np.pi * t_s / _STRIDE_S)
    forward = np.column_stack([np.cos(motion.yaw_rad), np.sin(motion.yaw_rad)])
    left = np.column_stack([-forward[:, 1], forward[:, 0]])
    centres = [motion.position_m + left * part.left_m + forward * (part.swing_m * swing)[:, None] for part in BODY]
    return np.stack(centres, axis=1)


def ray_ranges(origins_m: Float, directions: Float, centres_m: Float) -> Float:
    """(N,) range at which each ray first meets the body, inf where it does not.

    origins_m and directions (N, 3) in map, unit length; centres_m (N, parts, 2) at each ray's own instant.
    """
    nearest_m = np.full(len(origins_m), np.inf)
    for index, part in enumerate(BODY):
        np.minimum(nearest_m, _cylinder_ranges(origins_m, directions, centres_m[:, index], part), out=nearest_m)
    return nearest_m


def _cylinder_ranges(origins_m: Float, directions: Float, centres_m: Float, part: BodyPart) -> Float:
    """A ray is inside where it is inside the endless cylinder and between its two heights at once."""
    offset_m = origins_m[:, :2] - centres_m
    flat = directions[:, :2]
    # |offset + t flat|^2 = radius^2
    a = np.maximum(np.sum(flat**2, axis=1), 1e-12)
    half_b = np.sum(offset_m * flat, axis=1)
    root = half_b**2 - a * (np.sum(offset_m**2, axis=1) - part.radius_m**2)
    reach = np.sqrt(np.maximum(root, 0.0))
    slope = np.where(np.abs(directions[:, 2]) < 1e-12, 1e-12, directions[:, 2])
    heights = (np.array([part.low_m, part.high_m]) - origins_m[:, 2:]) / slope[:, None]
    enter_m = np.maximum((-half_b - reach) / a, heights.min(axis=1))
    leave_m = np.minimum((-half_b + reach) / a, heights.max(axis=1))
    return np.where((root > 0) & (enter_m < leave_m) & (enter_m > 0), enter_m, np.inf)


class TruePointClass(IntEnum):
    """What a point really is."""

    GROUND = 0
    OBSTACLE = 1
    PERSON = 2
    PASSER_BY = 3
    FALSE = 4


REFLECTIVITY = np.array([18.0, 60.0, 35.0, 30.0, 2.0], np.float32)
"""Intensity of a return, 0 to 255, by TruePointClass; a false point is weak."""


@dataclass(frozen=True, slots=True)
class Lidar:
    """Beams from -15 to +15 degrees, 10 Hz, clockwise from the back [Following, Fig. 4]; the rest as in a VLP-16.

    false_share of the returns are false: ranges drawn evenly between
    min_range_m and false_range_m in place of the true ones. Rays without a
    return are left out.
    """

    azimuth_steps: int = 1875
    beams: int = 16
    half_view_rad: float = float(np.deg2rad(15.0))
    sweep_ns: int = 100_000_000
    min_range_m: float = 0.3
    max_range_m: float = 100.0
    resolution_m: float = 0.002
    range_std_m: float = 0.02
    dropout_share: float = 0.01
    false_share: float = 0.007
    false_range_m: float = 30.0

    def directions(self) -> Float:
        """(steps * beams, 3) unit vectors in lidar, in firing order: all beams of a step, lowest first."""
        azimuth_rad = np.repeat(np.pi - 2 * np.pi * np.arange(self.azimuth_steps) / self.azimuth_steps, self.beams)
        elevation_rad = np.tile(np.linspace(-self.half_view_rad, self.half_view_rad, self.beams), self.azimuth_steps)
        flat = np.cos(elevation_rad)
        return np.column_stack([flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.sin(elevation_rad)])


@dataclass(frozen=True, slots=True)
class SimulatedScan:
    """One sweep as it is recorded, and what each of its N points really is.

    cloud: see PointCloud, in lidar at each point's own instant; intensity: (N,) float32.
    point_class: (N,) uint8 of TruePointClass; range_m: (N,) true range, NaN for false points.
    """

    cloud: PointCloud
    intensity: NDArray[np.float32]
    point_class: NDArray[np.uint8]
    range_m: Float


@dataclass(frozen=True, slots=True)
class SweepScene:
    """What a sweep meets: what stands, who carries the sensor, who walks in front of it and as what class."""

    caster: RayCaster
    robot: Walk
    people: tuple[tuple[Walk, TruePointClass], ...]
    transform_lidar_to_base: Float


def sweep(lidar: Lidar, world: SweepScene, start_ns: int, stamp_ns: int, rng: np.random.Generator) -> SimulatedScan:
    """The sweep that starts at stamp_ns, in a world whose walks start at start_ns."""
    offset_ns = np.arange(lidar.azimuth_steps, dtype=np.int64) * lidar.sweep_ns // lidar.azimuth_steps
    t_s = seconds_since(stamp_ns + offset_ns, start_ns)
    directions = lidar.directions()
    range_m, point_class = _true_returns(lidar, world, t_s, directions)
    measured_m = range_m + rng.normal(0.0, lidar.range_std_m, len(range_m))
    lost = rng.random(len(range_m)) < lidar.dropout_share
    false = rng.random(len(range_m)) < lidar.false_share
    false_m = rng.uniform(lidar.min_range_m, lidar.false_range_m, len(range_m))
    measured_m = np.where(false, false_m, measured_m)
    measured_m = np.round(measured_m / lidar.resolution_m) * lidar.resolution_m

    kept = np.isfinite(range_m) & ~lost & (measured_m >= lidar.min_range_m) & (measured_m <= lidar.max_range_m)
    point_class = np.where(false, np.uint8(TruePointClass.FALSE), point_class)[kept]
    ring = np.tile(np.arange(lidar.beams, dtype=np.uint16), lidar.azimuth_steps)
    cloud = PointCloud(
        stamp_ns=stamp_ns,
        frame_id="lidar",
        xyz_m=(directions[kept] * measured_m[kept, None]).astype(np.float32),
        ring=ring[kept],
        offset_ns=np.repeat(offset_ns, lidar.beams)[kept],
    )
    return SimulatedScan(cloud, REFLECTIVITY[point_class], point_class, np.where(false, np.nan, range_m)[kept])


def _true_returns(lidar: Lidar, world: SweepScene, t_s: Float, directions: Float) -> tuple[Float, NDArray[np.uint8]]:
    """Range (rays,), inf without a return, and class (rays,) of every ray of a sweep without noise."""
    origins_m, directions_map = _rays_in_map(world, t_s, directions, lidar.beams)
    hits = world.caster.cast(origins_m, directions_map)
    range_m = np.where(hits.what == NOTHING, np.inf, hits.range_m)
    point_class = np.where(hits.what == GROUND, TruePointClass.GROUND, TruePointClass.OBSTACLE).astype(np.uint8)
    for walk, own_class in world.people:
        centres_m = np.repeat(part_centres(walk, t_s), lidar.beams, axis=0)
        above_ground_m = origins_m.copy()
        above_ground_m[:, 2] -= np.repeat(walk.at(t_s).height_m, lidar.beams)
        body_m = ray_ranges(above_ground_m, directions_map, centres_m)
        point_class[body_m < range_m] = own_class
        range_m = np.minimum(range_m, body_m)
    return np.where(range_m <= lidar.max_range_m, range_m, np.inf), point_class


def _rays_in_map(world: SweepScene, t_s: Float, directions: Float, beams: int) -> tuple[Float, Float]:
    """Origins and directions (rays, 3) in map; the beams of a step share its instant."""
    motion = world.robot.at(t_s)
    mount_m = world.transform_lidar_to_base[:3, 3]
    origins_m = position_in_map(motion, np.broadcast_to(mount_m, (len(t_s), 3)))
    of_each_ray = Motion(*(np.repeat(each, beams, axis=0) for each in motion))
    in_base = directions @ world.transform_lidar_to_base[:3, :3].T
    return np.repeat(origins_m, beams, axis=0), turned_into_map(of_each_ray, in_base)
