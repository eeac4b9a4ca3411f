"""The window of a grid that lies around a robot, and arrays that follow it: they grow with the ground, or slide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from quadlog.messages import Float, Int

Grid = NDArray[np.bool_]
"""(rows, cols), true in cells that are occupied."""

Cell = TypeVar("Cell", bound=np.generic)
# Cells beyond this are farther than float64 can tell neighbours apart.
FARTHEST_CELL = 2.0**50


@dataclass(frozen=True, slots=True)
class Window:
    """`shape` (rows, cols) cells of edge cell_m, the lower-left one being (col0, row0) of the lattice."""

    col0: int
    row0: int
    cell_m: float
    shape: tuple[int, int]

    @property
    def origin_m(self) -> Float:
        """The lower-left corner (2,) in map."""
        return np.array([self.col0, self.row0]) * self.cell_m

    def cell_of(self, xy_m: Float) -> Int:
        """The cells (..., 2) as (col, row) in this window that hold points (..., 2) of map; may lie outside.

        Raises ValueError for a point that is not finite.
        """
        return _lattice_cell_of(xy_m, self.cell_m) - np.array([self.col0, self.row0])

    def centre_of(self, cells: NDArray[np.integer[Any]]) -> Float:
        """The centres (..., 2) in map of cells (..., 2) of this window."""
        centres: Float = (np.asarray(cells) + np.array([self.col0, self.row0]) + 0.5) * self.cell_m
        return centres

    def contains(self, cells: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
        """Which of the cells (..., 2) lie in this window: (...) bool."""
        cells = np.asarray(cells)
        return np.asarray(((cells >= 0) & (cells < np.array([self.shape[1], self.shape[0]]))).all(axis=-1))

    def shift_to(self, other: Window) -> tuple[int, int]:
        """How far (dcol, drow) `other` of the same lattice lies from this: cell c of this is cell c - shift of it."""
        return other.col0 - self.col0, other.row0 - self.row0


def window_around(xy_m: Float, cell_m: float, size_cells: int) -> Window:
    """The square window of size_cells whose middle cell holds the point (2,): it moves in whole cells. [Following]"""
    col, row = _lattice_cell_of(xy_m, cell_m).tolist()
    return Window(col - size_cells // 2, row - size_cells // 2, cell_m, (size_cells, size_cells))


def window_at(origin_m: Float, cell_m: float, shape: tuple[int, ...]) -> Window:
    """The window of `shape` (rows, cols) whose lower-left corner lies at origin_m (2,), as files keep it."""
    col0, row0 = (int(index) for index in np.rint(np.asarray(origin_m) / cell_m))
    return Window(col0, row0, float(cell_m), (int(shape[0]), int(shape[1])))


def crop(grid: NDArray[Cell], of: Window, to: Window) -> NDArray[Cell]:
    """What a grid (rows, cols) of one window has in another one of the same lattice, zero where they do not overlap."""
    dcol, drow = of.shift_to(to)
    cropped = np.zeros(to.shape, dtype=grid.dtype)
    rows = slice(max(-drow, 0), max(min(of.shape[0] - drow, to.shape[0]), 0))
    cols = slice(max(-dcol, 0), max(min(of.shape[1] - dcol, to.shape[1]), 0))
    if rows.start < rows.stop and cols.start < cols.stop:
        cropped[rows, cols] = grid[rows.start + drow : rows.stop + drow, cols.start + dcol : cols.stop + dcol]
    return cropped


def _lattice_cell_of(xy_m: Float, cell_m: float) -> Int:
    xy_m = np.asarray(xy_m, dtype=np.float64)
    if not np.isfinite(xy_m).all():
        raise ValueError("a position that is not finite lies in no cell")
    # Not clip, which takes twice as long for a single point.
    return np.maximum(np.minimum(np.floor(xy_m / cell_m), FARTHEST_CELL), -FARTHEST_CELL).astype(np.int64)


# Grown by more than is needed, so that a walking robot does not copy the map with every scan.
SPARE_CELLS = 64
# 16.8 million cells: 410 m by 410 m of 0.1 m. A pose that jumps to the moon must not take all memory.
MOST_CELLS = 4096 * 4096


class GrowingLattice:
    """Named arrays over one window of the lattice, zero where nothing was added; layers: their dtypes.

    covered: what was covered so far, None before the first window. skipped: how often there was no room.
    """

    def __init__(self, cell_m: float, layers: dict[str, DTypeLike], most_cells: int = MOST_CELLS) -> None:
        self._most_cells = most_cells
        self._held = Window(0, 0, cell_m, (0, 0))
        self._layers = {name: np.zeros((0, 0), dtype=dtype) for name, dtype in layers.items()}
        self.covered: Window | None = None
        self.skipped = 0

    def cover(self, window: Window) -> bool:
        """Make room for a window. False, and nothing changes, when that would exceed the limit."""
        covered = window if self.covered is None else _union(self.covered, window)
        if covered.shape[0] * covered.shape[1] > self._most_cells:
            self.skipped += 1
            return False
        self.covered = covered
        if 0 in self._held.shape or _union(self._held, covered) != self._held:
            (rows, cols), spare = covered.shape, SPARE_CELLS
            shape = rows + 2 * spare, cols + 2 * spare
            self._move(Window(covered.col0 - spare, covered.row0 - spare, covered.cell_m, shape))
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
    """The smallest window that contains both."""
    col0, row0 = min(one.col0, other.col0), min(one.row0, other.row0)
    cols = max(one.col0 + one.shape[1], other.col0 + other.shape[1]) - col0
    rows = max(one.row0 + one.shape[0], other.row0 + other.shape[0]) - row0
    return Window(col0, row0, one.cell_m, (rows, cols))
