"""The ground's height over the whole run: the terrain that was walked, as `ground.npz` keeps it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.mapping.lattice import MOST_CELLS, GrowingLattice
from quadlog.mapping.window import Window
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
        self.skipped = 0

    def add(self, xy_map_m: Float, height_m: Float) -> None:
        """Count one scan's ground: finite points (N, 2) in map and their heights (N,)."""
        if len(xy_map_m) == 0:
            return
        cells = Window(0, 0, self._cell_m, (0, 0)).cell_of(xy_map_m)
        (col0, row0), (col1, row1) = cells.min(axis=0), cells.max(axis=0)
        window = Window(int(col0), int(row0), self._cell_m, (int(row1 - row0) + 1, int(col1 - col0) + 1))
        if not self._lattice.cover(window):
            self.skipped += 1
            return
        within = cells - np.array([col0, row0])
        _add(self._lattice.view("sum_m", window), self._lattice.view("count", window), within, height_m)

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


@njit(cache=True)
def _add(sum_m: Float, count: NDArray[np.int32], cells: Int, height_m: Float) -> None:
    for i in range(len(cells)):
        sum_m[cells[i, 1], cells[i, 0]] += height_m[i]
        count[cells[i, 1], cells[i, 0]] += 1
