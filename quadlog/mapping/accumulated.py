"""One map of the whole run: how often each cell was seen occupied, and how often seen through."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.mapping.lattice import MOST_CELLS, GrowingLattice
from quadlog.mapping.occupancy import Grid
from quadlog.mapping.window import Window

UNKNOWN, FREE, OCCUPIED = -1, 0, 100

# A cell is occupied when it was hit in this share of the scans that say anything
# about it. Below one half, because range noise spreads a thin pole's returns
# over several cells, and a missed obstacle costs more than a false one.
OCCUPIED_SHARE = 0.3


class AccumulatedMap:
    """Counts of hits and passes per cell over all scans added, on a lattice that grows with the run.

    skipped: scans that were left out because the run's extent exceeds the limit; the caller must say so.
    """

    def __init__(self, cell_m: float, most_cells: int = MOST_CELLS) -> None:
        self._lattice = GrowingLattice(cell_m, {"hits": np.int32, "passes": np.int32}, most_cells)
        self.skipped = 0

    def add(self, window: Window, hit: Grid, crossed: Grid) -> None:
        """Count one scan: cells (rows, cols) in which something was hit, and cells that were seen through.

        A cell counts at most once per scan, and as a hit if it is both.
        """
        if not self._lattice.cover(window):
            self.skipped += 1
            return
        _count(hit, crossed, self._lattice.view("hits", window), self._lattice.view("passes", window))

    def to_cells(self) -> tuple[NDArray[np.int8], Window] | None:
        """Cells (rows, cols) int8, UNKNOWN, FREE or OCCUPIED, and the window they fill; None when no scan was added."""
        window = self._lattice.covered
        if window is None:
            return None
        hits, passes = self._lattice.view("hits", window), self._lattice.view("passes", window)
        cells = np.full(window.shape, UNKNOWN, dtype=np.int8)
        cells[passes > 0] = FREE
        cells[(hits > 0) & (hits >= OCCUPIED_SHARE * (hits + passes))] = OCCUPIED
        return cells, window


# Compiled, because numpy adds truth values to counts through a buffer.
@njit(cache=True, error_model="numpy")
def _count(hit: Grid, crossed: Grid, hits: NDArray[np.int32], passes: NDArray[np.int32]) -> None:
    for row in range(hit.shape[0]):
        for col in range(hit.shape[1]):
            hits[row, col] += hit[row, col]
            passes[row, col] += crossed[row, col] and not hit[row, col]
