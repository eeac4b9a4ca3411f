"""Obstacles grow by the robot's size, so that planning may treat the robot as a point."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from quadlog.mapping.occupancy import Grid
from quadlog.messages import Int


def inflate(occupied: Grid, radius_cells: float) -> Grid:
    """Every cell whose centre lies within radius_cells of an occupied cell's centre. Raises ValueError below 0."""
    reach = _reach(occupied, radius_cells)
    rows_away = np.arange(-reach, reach + 1)
    # A hair more, so that a radius of exactly n cells, computed as metres / metres, reaches the n-th cell.
    half_widths = np.floor(np.sqrt(np.maximum((radius_cells + 1e-9) ** 2 - rows_away**2, 0.0))).astype(np.int64)
    return _stamp(occupied, half_widths)


def inflate_square(occupied: Grid, radius_cells: float) -> Grid:
    """Every cell no more than radius_cells columns and rows from an occupied cell. [Planning] ValueError below 0."""
    reach = _reach(occupied, radius_cells)
    return _stamp(occupied, np.full(2 * reach + 1, reach))


INFLATIONS = {"euclidean": inflate, "square": inflate_square}
"""The shapes by which obstacles grow."""


def _reach(occupied: Grid, radius_cells: float) -> int:
    """Whole cells to either side that a stamp covers, no more than the grid is large."""
    if not radius_cells >= 0:
        raise ValueError(f"obstacles cannot grow by {radius_cells} cells")
    return math.floor(min(radius_cells + 1e-9, max(occupied.shape)))


@njit(cache=True)
def _stamp(occupied: Grid, half_widths: Int) -> Grid:
    """Stamp a shape, given by its half width in each row, on every occupied cell that has a free neighbour.

    A cell between four occupied ones adds nothing: on the way from it to any
    cell that its stamp reaches, the last occupied cell is nearer to that cell.
    """
    rows, cols = occupied.shape
    reach = len(half_widths) // 2
    grown = occupied.copy()
    for row in range(rows):
        for col in range(cols):
            if not occupied[row, col]:
                continue
            enclosed = (
                (row == 0 or occupied[row - 1, col])
                and (row == rows - 1 or occupied[row + 1, col])
                and (col == 0 or occupied[row, col - 1])
                and (col == cols - 1 or occupied[row, col + 1])
            )
            if enclosed:
                continue
            for near_row in range(max(row - reach, 0), min(row + reach + 1, rows)):
                half = half_widths[near_row - row + reach]
                grown[near_row, max(col - half, 0) : min(col + half + 1, cols)] = True
    return grown
