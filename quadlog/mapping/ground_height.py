"""The ground's height over the whole run: the terrain that was walked, as `ground.npz` keeps it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import kernel
from quadlog.mapping.compact import CompactScan
from quadlog.mapping.lattice import MOST_CELLS, GrowingLattice
from quadlog.mapping.window import FARTHEST_CELL, Window
from quadlog.messages import Float, Int


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
        self._cells, self._bounds = np.zeros((0, 2), np.int64), np.zeros(4, np.int64)
        self.skipped = 0

    def add(self, scan: CompactScan, slot_pose_base_in_map: Float) -> None:
        """Count one scan's ground; slot_pose_base_in_map: (K, 3) x, y, yaw at its time slots."""
        n = len(scan.ground)
        if n == 0:
            return
        if n > len(self._cells):
            self._cells = np.zeros((2 * n, 2), np.int64)
        cells, bounds = self._cells, self._bounds
        _cells_of_ground(scan.ground, scan.ground_slot, slot_pose_base_in_map, scan.unit_m, self._cell_m, cells, bounds)
        col0, row0, col1, row1 = (int(bound) for bound in bounds)
        window = Window(col0, row0, self._cell_m, (row1 - row0 + 1, col1 - col0 + 1))
        if not self._lattice.cover(window):
            self.skipped += 1
            return
        sums, row, col = self._lattice.whole("sum_m", window)
        counts, _, _ = self._lattice.whole("count", window)
        _add(scan.ground, scan.ground_count, cells, col0 - col, row0 - row, sums, counts)

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


@kernel
def _cells_of_ground(
    ground: NDArray[np.int16],
    slot: NDArray[np.uint8],
    poses: Float,
    unit_m: float,
    cell_m: float,
    cells: Int,
    bounds: Int,
) -> None:
    """The lattice's cells (col, row) of the ground's means, and their bounds."""
    bounds[0], bounds[1], bounds[2], bounds[3] = FARTHEST_CELL, FARTHEST_CELL, -FARTHEST_CELL, -FARTHEST_CELL
    moved = np.empty((len(poses), 4))
    for k in range(len(poses)):
        moved[k, 0], moved[k, 1] = math.cos(poses[k, 2]) * unit_m, math.sin(poses[k, 2]) * unit_m
        moved[k, 2], moved[k, 3] = poses[k, 0], poses[k, 1]
    for i in range(len(ground)):
        at, x, y = slot[i], ground[i, 0] + 0.5, ground[i, 1] + 0.5
        col = np.floor((moved[at, 2] + moved[at, 0] * x - moved[at, 1] * y) / cell_m)
        row = np.floor((moved[at, 3] + moved[at, 1] * x + moved[at, 0] * y) / cell_m)
        cells[i, 0] = np.int64(min(max(col, -FARTHEST_CELL), FARTHEST_CELL))
        cells[i, 1] = np.int64(min(max(row, -FARTHEST_CELL), FARTHEST_CELL))
        bounds[0], bounds[2] = min(bounds[0], cells[i, 0]), max(bounds[2], cells[i, 0])
        bounds[1], bounds[3] = min(bounds[1], cells[i, 1]), max(bounds[3], cells[i, 1])


@kernel
def _add(
    ground: NDArray[np.int16],
    points: NDArray[np.uint16],
    cells: Int,
    col0: int,
    row0: int,
    sum_m: Float,
    count: NDArray[np.int32],
) -> None:
    for i in range(len(ground)):
        row, col = cells[i, 1] - row0, cells[i, 0] - col0
        sum_m[row, col] += points[i] * (ground[i, 2] * 0.001)
        count[row, col] += points[i]
