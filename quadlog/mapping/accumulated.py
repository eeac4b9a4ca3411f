"""One map of the whole run: how often each cell was seen occupied, and how often seen through."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import kernel
from quadlog.mapping.lattice import MOST_CELLS, GrowingLattice
from quadlog.mapping.placing import NO_TOP, PlacedScan
from quadlog.mapping.rays import NO_RAY
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

    def add(self, window: Window, placed: PlacedScan, below_mm: int) -> None:
        """Count one scan: cells (rows, cols) in which something was hit, and cells seen through below this height.

        A cell counts at most once per scan, and as a hit if it is both.
        """
        if not self._lattice.cover(window):
            self.skipped += 1
            return
        hits, row, col = self._lattice.whole("hits", window)
        passes, _, _ = self._lattice.whole("passes", window)
        _count(placed.top_mm, placed.lowest_ray_mm, np.int16(min(below_mm, int(NO_RAY))), hits, passes, row, col)

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


@kernel
def _count(
    top_mm: NDArray[np.int16],
    lowest_ray_mm: NDArray[np.int16],
    below_mm: int,
    hits: NDArray[np.int32],
    passes: NDArray[np.int32],
    first_row: int,
    first_col: int,
) -> None:
    one, none = np.int32(1), np.int32(0)
    rows, cols = top_mm.shape
    for row in range(rows):
        top, ray = top_mm[row], lowest_ray_mm[row]
        hit, passed = hits[first_row + row, first_col:], passes[first_row + row, first_col:]
        for col in range(cols):
            hit[col] += one if top[col] > NO_TOP else none
            passed[col] += one if (ray[col] < below_mm) & (top[col] <= NO_TOP) else none
