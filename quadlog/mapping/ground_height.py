"""The ground's height over the whole run: the terrain that was walked, as `ground.npz` keeps it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.lidar.points import PointClass, columns_of
from quadlog.mapping.lattice import MOST_CELLS, GrowingLattice
from quadlog.mapping.window import FARTHEST_CELL, Window
from quadlog.messages import Float, Float32, Int

_GROUND = np.uint8(PointClass.GROUND)


@dataclass(frozen=True, slots=True)
class HeightMap:
    """Mean height of the ground per cell.

    origin_m: (2,) lower-left corner in map; height_m: (rows, cols) float32,
    NaN where no ground was seen; count: (rows, cols) int32 points per cell.
    """

    origin_m: Float
    cell_m: float
    height_m: NDArray[np.float32]
    count: NDArray[np.int32]


class GroundHeight:
    """Sum and count of ground points' heights per cell, on a lattice that grows with the run.

    skipped: scans that were left out because the run's extent exceeds the limit; the caller must say so.
    """

    def __init__(self, cell_m: float, most_cells: int = MOST_CELLS // 4) -> None:
        self._cell_m = cell_m
        self._lattice = GrowingLattice(cell_m, {"sum_m": np.float64, "count": np.int32}, most_cells)
        self.skipped = 0

    def add(self, xyz_base_m: Float32, label: NDArray[np.uint8], pose_base_in_map: Float) -> None:
        """Count one scan's points (N, 3) that are ground by their label (N,); pose_base_in_map: (3,) x, y, yaw."""
        x_m, y_m, yaw_rad = (float(value) for value in pose_base_in_map)
        place = np.array([math.cos(yaw_rad), math.sin(yaw_rad), x_m, y_m]) / self._cell_m
        cells, bounds = np.empty((len(label), 2), np.int64), np.empty(4, np.int64)
        base_x_m, base_y_m, base_z_m = columns_of(xyz_base_m)
        n = _cells_of_ground(base_x_m, base_y_m, label, place, cells, bounds)
        if n == 0:
            return
        col0, row0, col1, row1 = (int(bound) for bound in bounds)
        window = Window(col0, row0, self._cell_m, (row1 - row0 + 1, col1 - col0 + 1))
        if not self._lattice.cover(window):
            self.skipped += 1
            return
        sums, counts = self._lattice.view("sum_m", window), self._lattice.view("count", window)
        _add(base_z_m, label, cells, col0, row0, sums, counts)

    def to_map(self) -> HeightMap | None:
        """The mean height of every cell seen; None when no ground was."""
        window = self._lattice.covered
        if window is None:
            return None
        count = self._lattice.view("count", window).copy()
        height_m = np.full(window.shape, np.nan, dtype=np.float32)
        seen = count > 0
        height_m[seen] = self._lattice.view("sum_m", window)[seen] / count[seen]
        return HeightMap(window.origin_m, window.cell_m, height_m, count)


@njit(cache=True, error_model="numpy")
def _cells_of_ground(
    base_x_m: Float32,
    base_y_m: Float32,
    label: NDArray[np.uint8],
    place: Float,
    cells: Int,
    bounds: Int,
) -> int:
    """The lattice's cells (col, row) of the ground's points one after the other, their bounds, and how many.

    place: cosine and sine of base's yaw, and its x and y, all in cells.
    """
    cos, sin, n = place[0], place[1], 0
    bounds[0], bounds[1], bounds[2], bounds[3] = FARTHEST_CELL, FARTHEST_CELL, -FARTHEST_CELL, -FARTHEST_CELL
    for i in range(len(label)):
        if label[i] != _GROUND:
            continue
        x, y = base_x_m[i], base_y_m[i]
        col, row = np.floor(place[2] + cos * x - sin * y), np.floor(place[3] + sin * x + cos * y)
        cells[n, 0] = np.int64(min(max(col, -FARTHEST_CELL), FARTHEST_CELL))
        cells[n, 1] = np.int64(min(max(row, -FARTHEST_CELL), FARTHEST_CELL))
        bounds[0], bounds[2] = min(bounds[0], cells[n, 0]), max(bounds[2], cells[n, 0])
        bounds[1], bounds[3] = min(bounds[1], cells[n, 1]), max(bounds[3], cells[n, 1])
        n += 1
    return n


@njit(cache=True, error_model="numpy")
def _add(
    base_z_m: Float32,
    label: NDArray[np.uint8],
    cells: Int,
    col0: int,
    row0: int,
    sum_m: Float,
    count: NDArray[np.int32],
) -> None:
    n = 0
    for i in range(len(label)):
        if label[i] == _GROUND:
            row, col = cells[n, 1] - row0, cells[n, 0] - col0
            sum_m[row, col] += base_z_m[i]
            count[row, col] += 1
            n += 1
