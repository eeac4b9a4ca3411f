"""One map of the whole run: how often each cell was seen occupied, and how often seen through."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.mapping.lattice import MOST_CELLS, GrowingLattice
from quadlog.mapping.occupancy import Grid
from quadlog.mapping.window import Window
from quadlog.messages import Float

UNKNOWN, FREE, OCCUPIED = -1, 0, 100

# A cell is occupied when it was hit in this share of the maps that say anything
# about it. Below one half, because range noise spreads a thin pole's returns
# over several cells, and a missed obstacle costs more than a false one.
OCCUPIED_SHARE = 0.3


class AccumulatedMap:
    """Counts of hits and passes per cell over all maps added, on a lattice that grows with the run.

    skipped: maps that were left out because the run's extent exceeds the limit; the caller must say so.
    """

    def __init__(self, cell_m: float, most_cells: int = MOST_CELLS) -> None:
        self._lattice = GrowingLattice(cell_m, {"hits": np.int32, "passes": np.int32}, most_cells)
        self.skipped = 0

    def add(self, window: Window, occupied: Grid, robot_xy_m: Float, seen_free: Grid | None = None) -> None:
        """Count one map (rows, cols), seen from the robot (2,) in map.

        A hit is an occupied cell; a pass is a cell that the line from the
        robot to an occupied cell crosses before it meets any occupied one, or
        one that seen_free marks (where the ground itself was seen). A cell
        counts at most once per map, and as a hit if it is both.
        """
        if not self._lattice.cover(window):
            self.skipped += 1
            return
        passed = np.zeros(window.shape, dtype=np.bool_) if seen_free is None else seen_free & ~occupied
        col, row = window.cell_of(robot_xy_m)
        if window.contains(np.array([col, row])):
            _carve(occupied, int(col), int(row), passed)
        self._lattice.view("hits", window)[...] += occupied
        self._lattice.view("passes", window)[...] += passed

    def to_cells(self) -> tuple[NDArray[np.int8], Window] | None:
        """Cells (rows, cols) int8, UNKNOWN, FREE or OCCUPIED, and the window they fill; None when no map was added."""
        window = self._lattice.covered
        if window is None:
            return None
        hits, passes = self._lattice.view("hits", window), self._lattice.view("passes", window)
        cells = np.full(window.shape, UNKNOWN, dtype=np.int8)
        cells[passes > 0] = FREE
        cells[(hits > 0) & (hits >= OCCUPIED_SHARE * (hits + passes))] = OCCUPIED
        return cells, window


@njit(cache=True)
def _carve(occupied: Grid, robot_col: int, robot_row: int, passed: Grid) -> None:
    """Mark the cells on Bresenham's line from the robot to every occupied cell, up to the first occupied one."""
    rows, cols = occupied.shape
    for end_row in range(rows):
        for end_col in range(cols):
            if not occupied[end_row, end_col]:
                continue
            along_col, along_row = abs(end_col - robot_col), -abs(end_row - robot_row)
            step_col = 1 if end_col > robot_col else -1
            step_row = 1 if end_row > robot_row else -1
            error, col, row = along_col + along_row, robot_col, robot_row
            while not occupied[row, col]:
                passed[row, col] = True
                doubled = 2 * error
                if doubled >= along_row:
                    error += along_row
                    col += step_col
                if doubled <= along_col:
                    error += along_col
                    row += step_row
