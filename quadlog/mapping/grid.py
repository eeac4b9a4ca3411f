"""The window of a grid that lies around a robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

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
        """How far (dcol, drow) `other` lies from this window: cell c of this one is cell c - shift of the other.

        Raises ValueError when the cells differ in size: then no whole number of cells lies between.
        """
        if other.cell_m != self.cell_m:
            raise ValueError(f"windows with cells of {self.cell_m} m and {other.cell_m} m share no lattice")
        return other.col0 - self.col0, other.row0 - self.row0


def window_around(xy_m: Float, cell_m: float, size_cells: int) -> Window:
    """The square window of size_cells whose middle cell holds the point (2,): it moves in whole cells. [Following]"""
    col, row = (int(index) for index in _lattice_cell_of(xy_m, cell_m))
    return Window(col - size_cells // 2, row - size_cells // 2, cell_m, (size_cells, size_cells))


def window_at(origin_m: Float, cell_m: float, shape: tuple[int, ...]) -> Window:
    """The window of `shape` (rows, cols) whose lower-left corner lies at origin_m (2,), as files keep it."""
    col0, row0 = (int(index) for index in np.rint(np.asarray(origin_m) / cell_m))
    return Window(col0, row0, float(cell_m), (int(shape[0]), int(shape[1])))


def crop(grid: NDArray[Cell], of: Window, to: Window) -> NDArray[Cell]:
    """What a grid (rows, cols) of one window has in another one of the same lattice, zero where they do not overlap.

    Raises ValueError when the cells differ in size.
    """
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
