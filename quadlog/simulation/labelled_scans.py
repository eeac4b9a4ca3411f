"""Single scans of many places with the true class of every point: what the lidar's tables are measured on.

Every scan has its own layout and pose, all drawn from the seed and the scan's
number: the robot stands still, as if the scan were deskewed already. In every
other scan it is caught in mid-gait, rolled and pitched by about two degrees.
On the uniform slopes it stands parallel to the ground in two scans of four,
and holds its body level with its legs in the other two.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import UnknownName
from quadlog.geometry import apply_transform, transform_from_rpy
from quadlog.lidar import points
from quadlog.messages import Float, Int
from quadlog.simulation.lidar_sensor import Lidar, PointClass, Scan, World, sweep
from quadlog.simulation.places import PLACES, Place
from quadlog.simulation.scene import RayCaster
from quadlog.simulation.walk import Motion

SCANS_LIDAR = Lidar(dropout_share=0.0, false_share=0.01)
"""16 beams of 1875 steps, 2 cm noise; 1 % of the returns are false: `Lidar` says how they are drawn."""

_MOUNT_HEIGHT_M = (0.4, 0.5)
_TRUTH = {
    PointClass.GROUND: points.PointClass.GROUND,
    PointClass.OBSTACLE: points.PointClass.OBSTACLE,
    PointClass.PERSON: points.PointClass.OBSTACLE,
    PointClass.PASSER_BY: points.PointClass.OBSTACLE,
    PointClass.FALSE: points.PointClass.OUTLIER,
    PointClass.MISSING: points.PointClass.INVALID,
}


@dataclass(frozen=True, slots=True)
class LabelledScan:
    """One scan of N points, as a driver sends them, column by column and each column bottom up, and its truth.

    xyz_lidar_m: (N, 3) float32, NaN for rays without a return where they are kept.
    ring: (N,) uint16 from 0, the lowest; offset_ns: (N,) relative to the first.
    truth: (N,) uint8 of quadlog.lidar.points.PointClass; never CROPPED. A false
    point is an OUTLIER even where its range happens to meet something.
    height_m: (N,) of the true point above the ground right below it, NaN for outliers and missing returns.
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

    @property
    def transform_base_to_level(self) -> Float:
        """(4, 4) turns base upright about its own origin, without its heading."""
        turn = self.transform_base_to_map.copy()
        yaw_rad = np.arctan2(turn[1, 0], turn[0, 0])
        turn[:3, 3] = 0.0
        unturned: Float = transform_from_rpy(np.zeros(3), 0.0, 0.0, -float(yaw_rad)) @ turn
        return unturned


def labelled_scans(name: str, seed: int, n: int, lidar: Lidar = SCANS_LIDAR) -> Iterator[LabelledScan]:
    """The first n scans of a place of PLACES; scan i does not depend on n. Raises UnknownName."""
    if name not in PLACES:
        raise UnknownName("place", name, PLACES)
    for index in range(n):
        rng = np.random.default_rng([seed, index, *name.encode()])
        yield _scan_at(PLACES[name](rng, index), rng, lidar)


def with_missing(lidar: Lidar = SCANS_LIDAR) -> Lidar:
    """The same sensor with the other style of driver: a ray without a return is sent as NaN."""
    return replace(lidar, keeps_missing=True)


def is_true_obstacle(scan: LabelledScan, min_height_m: float = 0.05, max_height_m: float = 1.5) -> NDArray[np.bool_]:
    """(N,) which points are returns from obstacles within these heights above the true ground below them."""
    within = (scan.height_m >= min_height_m) & (scan.height_m <= max_height_m)
    return within & (scan.truth == points.PointClass.OBSTACLE)


def true_obstacle_cells(
    scan: LabelledScan,
    cell_m: float,
    min_height_m: float = 0.05,
    max_height_m: float = 1.5,
    transform_lidar_to_grid: Float | None = None,
) -> Int:
    """The cells (M, 2), column and row, that true obstacle points fall into, each once and in order.

    transform_lidar_to_grid: (4, 4), of a grid with the corner of cell (0, 0)
    at its origin; without it the grid lies in base, neither levelled nor turned.
    """
    transform = scan.transform_lidar_to_base if transform_lidar_to_grid is None else transform_lidar_to_grid
    seen = is_true_obstacle(scan, min_height_m, max_height_m)
    xyz_m = apply_transform(transform, scan.xyz_lidar_m[seen].astype(np.float64))
    return np.unique(np.floor(xyz_m[:, :2] / cell_m).astype(np.int64), axis=0)


def _scan_at(place: Place, rng: np.random.Generator, lidar: Lidar) -> LabelledScan:
    height_m = float(rng.uniform(*_MOUNT_HEIGHT_M))
    mount = transform_from_rpy(np.array([0.0, 0.0, height_m]), 0.0, 0.0, 0.0)
    caster = RayCaster(place.obstacles, place.terrain)
    world = World(caster, place.robot, tuple((each, PointClass.PERSON) for each in place.people), mount)
    # What nobody does while the scan lasts needs no clock.
    scan = sweep(lidar, world, start_ns=0, stamp_ns=0, rng=rng)
    pose = _pose(place.robot.at(np.zeros(1)))
    assert scan.cloud.ring is not None
    assert scan.cloud.offset_ns is not None
    return LabelledScan(
        xyz_lidar_m=scan.cloud.xyz_m,
        ring=scan.cloud.ring,
        offset_ns=scan.cloud.offset_ns,
        truth=np.array([_TRUTH[each] for each in PointClass], dtype=np.uint8)[scan.point_class],
        height_m=_heights(scan, pose @ mount, place),
        transform_lidar_to_base=mount,
        transform_base_to_map=pose,
    )


def _pose(motion: Motion) -> Float:
    place_m = np.append(motion.position_m[0], motion.height_m[0])
    return transform_from_rpy(place_m, motion.roll_rad[0], motion.pitch_rad[0], motion.yaw_rad[0])


def _heights(scan: Scan, transform_lidar_to_map: Float, place: Place) -> Float:
    """(N,) heights of the points without their noise above the ground below them, NaN where there is no true point."""
    known = np.isfinite(scan.range_m)
    measured_m = scan.cloud.xyz_m[known].astype(np.float64)
    shrink = scan.range_m[known] / np.linalg.norm(measured_m, axis=1)
    in_map_m = apply_transform(transform_lidar_to_map, measured_m * shrink[:, None])
    height_m = np.full(len(known), np.nan)
    height_m[known] = in_map_m[:, 2] - place.terrain.height_at(in_map_m[:, :2])
    return height_m
