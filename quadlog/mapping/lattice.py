"""Arrays on the lattice that follow the robot: they grow with the ground a run covers, or slide with a window."""

from __future__ import annotations

import numpy as np
from numpy.typing import DTypeLike, NDArray

from quadlog.mapping.grid import Window, crop

# Grown in whole blocks, so that a walking robot does not copy the map with every scan.
BLOCK_CELLS = 128
# 16.8 million cells: 410 m by 410 m of 0.1 m. A pose that jumps to the moon must not take all memory.
MOST_CELLS = 4096 * 4096


class GrowingLattice:
    """Named arrays over one window of the lattice, zero where nothing was added; layers: the dtype of each.

    covered: what was covered so far, None before the first window.
    """

    def __init__(self, cell_m: float, layers: dict[str, DTypeLike], most_cells: int = MOST_CELLS) -> None:
        self._most_cells = most_cells
        self._held = Window(0, 0, cell_m, (0, 0))
        self._layers = {name: np.zeros((0, 0), dtype=dtype) for name, dtype in layers.items()}
        self.covered: Window | None = None

    def cover(self, window: Window) -> bool:
        """Make room for a window. False, and nothing changes, when that would exceed the limit."""
        covered = window if self.covered is None else _union(self.covered, window)
        if covered.shape[0] * covered.shape[1] > self._most_cells:
            return False
        self.covered = covered
        if _union(self._held, covered) != self._held:
            self._move(_in_blocks(covered))
        return True

    def whole(self, name: str, window: Window) -> tuple[NDArray, int, int]:
        """The whole layer, and the row and column at which a window that is covered begins in it.

        Compiled loops over a part of a two-dimensional array become no vector instructions; over its rows they do.
        """
        dcol, drow = self._held.shift_to(window)
        return self._layers[name], drow, dcol

    def view(self, name: str, window: Window) -> NDArray:
        """The layer within a window that is covered; writing to it changes the layer."""
        layer, row, col = self.whole(name, window)
        return layer[row : row + window.shape[0], col : col + window.shape[1]]

    def _move(self, window: Window) -> None:
        held, self._held = self._held, window
        self._layers = {name: crop(layer, held, window) for name, layer in self._layers.items()}


class SlidingLattice(GrowingLattice):
    """Layers as large as the window: what it leaves behind is forgotten."""

    def cover(self, window: Window) -> bool:
        """Slide to a window; there is always room for one."""
        if window != self._held:
            self._move(window)
        return True


def _union(one: Window, other: Window) -> Window:
    """The smallest window that contains both; an empty one adds nothing."""
    if 0 in one.shape or 0 in other.shape:
        return other if 0 in one.shape else one
    col0, row0 = min(one.col0, other.col0), min(one.row0, other.row0)
    cols = max(one.col0 + one.shape[1], other.col0 + other.shape[1]) - col0
    rows = max(one.row0 + one.shape[0], other.row0 + other.shape[0]) - row0
    return Window(col0, row0, one.cell_m, (rows, cols))


def _in_blocks(window: Window) -> Window:
    """The window with every edge moved outwards to a multiple of BLOCK_CELLS."""
    col0, row0 = (index // BLOCK_CELLS * BLOCK_CELLS for index in (window.col0, window.row0))
    cols = -(-(window.col0 + window.shape[1]) // BLOCK_CELLS) * BLOCK_CELLS - col0
    rows = -(-(window.row0 + window.shape[0]) // BLOCK_CELLS) * BLOCK_CELLS - row0
    return Window(col0, row0, window.cell_m, (rows, cols))
