"""Compact scans laid on the grid around the robot, once its poses are known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.mapping.compact import CompactScan
from quadlog.mapping.window import Window
from quadlog.messages import Float

NO_TOP, NO_RAY = np.int16(-32768), np.int16(32767)
"""In cells in which nothing was hit, and which no ray crossed."""


class PlacedScan(NamedTuple):
    """Cells (rows, cols) int16, in mm above the ground; both are overwritten by the next scan.

    top_mm: the highest obstacle point, NO_TOP where there is none. lowest_ray_mm: how low the cell was seen through,
    NO_RAY where no ray crossed it.
    """

    top_mm: NDArray[np.int16]
    lowest_ray_mm: NDArray[np.int16]


class ScanPlacer:
    """Places the scans of a run, one after the other, in arrays that are kept from scan to scan."""

    def __init__(self, min_points: int, target_radius_m: float) -> None:
        self._min_points, self._target_radius_m = min_points, target_radius_m

    def place(
        self, scan: CompactScan, slot_pose_base_in_map: Float, target_xy_m: Float | None, window: Window
    ) -> PlacedScan:
        """Tops and lowest rays of a scan in a window; slot_pose_base_in_map: (K, 3) x, y, yaw at its time slots.

        target_xy_m: (2,) in map; obstacle points near it are the target. None when nothing is followed.
        """
        top_mm = np.full(window.shape, NO_TOP, np.int16)
        count = np.zeros(window.shape, np.int64)
        xy_m = to_map(scan.obstacle[:, :2] * scan.unit_m, scan.obstacle_slot, slot_pose_base_in_map)
        cells = np.floor(xy_m / window.cell_m) - [window.col0, window.row0]
        inside = ((cells >= 0) & (cells < [window.shape[1], window.shape[0]])).all(axis=1)
        if target_xy_m is not None:
            inside &= ~(np.linalg.norm(xy_m - target_xy_m, axis=1) <= self._target_radius_m)
        at = tuple(cells[inside, ::-1].astype(np.int64).T)
        np.maximum.at(top_mm, at, scan.obstacle[inside, 2])
        np.add.at(count, at, scan.obstacle_count[inside])
        top_mm[count < self._min_points] = NO_TOP
        return PlacedScan(top_mm, np.full(window.shape, NO_RAY, np.int16))


def to_map(xy_base_m: Float, slot: NDArray[np.uint8], slot_pose_base_in_map: Float) -> Float:
    """Points (N, 2) of base in map, each by the pose of its time slot (N,)."""
    cos, sin = np.cos(slot_pose_base_in_map[:, 2])[slot], np.sin(slot_pose_base_in_map[:, 2])[slot]
    x, y = xy_base_m.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y]) + slot_pose_base_in_map[slot, :2]
