"""The classified returns of one scan, as the one pass over a recording hands them on: without the robot's pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from quadlog.lidar.classify import FEWEST_RETURNS, ClassifiedScan, Route
from quadlog.lidar.deskew import Slots
from quadlog.lidar.ground import Ground
from quadlog.lidar.points import PointClass, columns_of
from quadlog.messages import Float, Float32, Int


@dataclass(frozen=True, slots=True)
class ClassifiedReturns:
    """The returns of one scan along the axes of base made upright, as they were measured: nothing is deskewed.

    dx_m, dy_m (from the lidar), z_m (in base), height_m (above the ground), label (of PointClass), slot (of time): (M,)
    each. The first rows * columns of them are cells of a range image, row by row, INVALID where nothing returned; the
    others, or all where columns is 0, are in no order. The next scan of the same classifier overwrites them.
    counts: (5,) points of the message by PointClass. ground: the plane, without its inliers, or None. lidar_base_m:
    (3,) where the lidar stands, z above the ground. slots: when the time slots are. points: makes a ClassifiedScan of
    every point of the message, in its order, which costs more than classifying; not after the next scan.
    """

    dx_m: Float32
    dy_m: Float32
    z_m: Float32
    height_m: Float32
    label: NDArray[np.uint8]
    slot: NDArray[np.uint8]
    rows: int
    columns: int
    counts: Int
    ground: Ground | None
    route: Route
    lidar_base_m: Float
    slots: Slots
    points: Callable[[], ClassifiedScan]

    @classmethod
    def of_points(cls, scan: ClassifiedScan, lidar_base_m: Float, slot: NDArray[np.uint8], slots: Slots) -> Self:
        """The points (N, 3) of a scan that no image holds; slot: (N,)."""
        x_m, y_m, z_m = columns_of(scan.xyz_base_m)
        dx_m, dy_m = x_m - np.float32(lidar_base_m[0]), y_m - np.float32(lidar_base_m[1])
        arrays = dx_m, dy_m, z_m, scan.height_m, scan.label, slot
        counts = np.bincount(scan.label, minlength=len(PointClass))
        return cls(*arrays, 0, 0, counts, scan.ground, scan.route, lidar_base_m, slots, lambda: scan)

    @property
    def n_raw(self) -> int:
        """Points as they came."""
        return int(self.counts.sum())

    @property
    def n_valid(self) -> int:
        """Points that are finite, not (0, 0, 0) and in range, cropped ones included."""
        return self.n_raw - int(self.counts[PointClass.INVALID])

    @property
    def n_outlier(self) -> int:
        """Points without neighbours."""
        return int(self.counts[PointClass.OUTLIER])

    @property
    def n_ground(self) -> int:
        """Points on the ground."""
        return int(self.counts[PointClass.GROUND])

    @property
    def n_obstacle(self) -> int:
        """Points that are left."""
        return int(self.counts[PointClass.OBSTACLE])

    @property
    def shows_nothing(self) -> bool:
        """Whether a map would be wrong to say anything because of this scan: an empty one is no sight of free space."""
        return self.n_ground + self.n_obstacle < FEWEST_RETURNS
