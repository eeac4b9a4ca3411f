"""Compact scans laid on the grid around the robot, once its poses are known."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import kernel
from quadlog.mapping.compact import CompactScan, slot_transforms
from quadlog.mapping.grid import Window
from quadlog.mapping.ray_tracing import lowest_rays
from quadlog.messages import Float

NO_TOP = np.int16(-32768)
"""Height, in mm, of the highest obstacle point in a cell in which nothing was hit."""


class PlacedScan(NamedTuple):
    """Cells (rows, cols) int16, in mm above the ground; both are overwritten by the next scan.

    top_mm: the highest obstacle point, NO_TOP where there is none. lowest_ray_mm: how low the cell was seen through,
    NO_RAY where no ray crossed it.
    """

    top_mm: NDArray[np.int16]
    lowest_ray_mm: NDArray[np.int16]


class ScanPlacer:
    """Places the scans of a run, one after the other, in arrays that are kept from scan to scan.

    min_points: a cell with fewer obstacle points is not hit; in a scan without ground, as a 2-D scanner's, one is
    enough: a wall has no more. target_radius_m: points this near to the target are the target.
    """

    def __init__(self, min_points: int, target_radius_m: float) -> None:
        self._min_points, self._target_radius_m = min_points, target_radius_m
        self._placed = PlacedScan(np.zeros((0, 0), np.int16), np.zeros((0, 0), np.int16))

    def place(self, scan: CompactScan, slot_pose_base_in_map: Float, target_xy_m: Float, window: Window) -> PlacedScan:
        """Tops and lowest rays of a scan in a window; slot_pose_base_in_map: (K, 3) x, y, yaw at its time slots.

        target_xy_m: (2,) in map, NaN when nothing is followed.
        """
        if self._placed.top_mm.shape != window.shape:
            top_mm, lowest_ray_mm = np.zeros((2, *window.shape), np.int16)
            self._placed = PlacedScan(top_mm, lowest_ray_mm)
        # A place that is not a number is near to nothing.
        place = np.array([window.col0, window.row0, window.cell_m, *target_xy_m, self._target_radius_m**2], np.float64)
        min_points = self._min_points if len(scan.ground) else 1
        _raise_tops(scan.obstacle, slot_pose_base_in_map, scan.unit_m, place, min_points, self._placed.top_mm)
        where = scan.lidar_base_m, slot_pose_base_in_map, window, scan.reach_m
        lowest_rays(scan.rays, scan.unit_m, *where, self._placed.lowest_ray_mm)
        return self._placed


@kernel
def _raise_tops(
    obstacle: NDArray[np.void], poses: Float, unit_m: float, place: Float, min_points: int, top_mm: NDArray[np.int16]
) -> None:
    """place: the window's first column and row on the lattice, the edge of a cell, and the target's place and squared
    radius.
    """
    rows, cols = top_mm.shape
    top_mm[:] = NO_TOP
    counts = min_points > 1
    count = np.zeros((rows, cols) if counts else (0, 0), np.int32)
    moved = slot_transforms(poses, unit_m)
    per_cell, col0, row0 = 1.0 / place[2], place[0], place[1]
    for i in range(len(obstacle)):
        at, x, y = obstacle[i]["slot"], obstacle[i]["x"] + 0.5, obstacle[i]["y"] + 0.5
        map_x_m = moved[at, 2] + moved[at, 0] * x - moved[at, 1] * y
        map_y_m = moved[at, 3] + moved[at, 1] * x + moved[at, 0] * y
        dx, dy = map_x_m - place[3], map_y_m - place[4]
        col, row = math.floor(map_x_m * per_cell) - col0, math.floor(map_y_m * per_cell) - row0
        # Compared as floats: a huge or NaN coordinate must not reach the cast to an index.
        inside = col >= 0.0 and col < cols and row >= 0.0 and row < rows
        if inside and not dx * dx + dy * dy <= place[5]:
            at_row, at_col = np.uint32(row), np.uint32(col)
            top_mm[at_row, at_col] = max(top_mm[at_row, at_col], obstacle[i]["height_mm"])
            if counts:
                count[at_row, at_col] += obstacle[i]["count"]
    if counts:
        for r in range(rows):
            for c in range(cols):
                if count[r, c] < min_points:
                    top_mm[r, c] = NO_TOP
