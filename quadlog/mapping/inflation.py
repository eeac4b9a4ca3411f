"""Obstacles grow by the robot's size, so that planning may treat the robot as a point."""

from __future__ import annotations

import math

import numpy as np

from quadlog.mapping.grid import Grid
from quadlog.messages import Int


def inflate(occupied: Grid, radius_cells: float) -> Grid:
    """Every cell whose centre lies within radius_cells of an occupied cell's centre. Raises ValueError below 0."""
    rows_away = np.arange(_reach(occupied, radius_cells) + 1)
    # Slightly more, so that a radius of exactly n cells, computed as metres / metres, reaches the n-th cell.
    half_widths = np.floor(np.sqrt(np.maximum((radius_cells + 1e-9) ** 2 - rows_away**2, 0.0))).astype(np.int64)
    return _stamp(occupied, np.minimum(half_widths, rows_away[-1]))


def inflate_square(occupied: Grid, radius_cells: float) -> Grid:
    """Every cell no more than radius_cells columns and rows from an occupied cell. [Planning] ValueError below 0."""
    reach = _reach(occupied, radius_cells)
    return _stamp(occupied, np.full(reach + 1, reach))


INFLATIONS = {"euclidean": inflate, "square": inflate_square}
"""The shapes by which obstacles grow."""


def _reach(occupied: Grid, radius_cells: float) -> int:
    """Whole cells to either side that a stamp covers, no more than the grid is large."""
    if not radius_cells >= 0:
        raise ValueError(f"the inflation radius must be at least 0 cells, not {radius_cells}")
    return math.floor(min(radius_cells + 1e-9, max(occupied.shape)))


def _stamp(occupied: Grid, half_widths: Int) -> Grid:
    """Grow by a shape, symmetric and convex, given by its half width in the rows 0, 1, ... away from its middle.

    The grid is widened by one cell at a time, and what every row of the shape has widened is moved up and down to where
    that row lies. Within a frame of free cells, a move along the flat array leaves no row by more than the frame.
    """
    reach = len(half_widths) - 1
    framed = np.zeros((occupied.shape[0] + 2 * reach, occupied.shape[1] + 2 * reach), dtype=np.bool_)
    inside = np.s_[reach : reach + occupied.shape[0], reach : reach + occupied.shape[1]]
    framed[inside] = occupied
    seeds = framed.reshape(-1)
    widened, grown = seeds.copy(), np.zeros_like(seeds)
    half = 0
    for rows_away in range(reach, -1, -1):
        while half < half_widths[rows_away]:
            half += 1
            _add_moved(widened, seeds, half)
        _add_moved(grown, widened, rows_away * framed.shape[1])
    return grown.reshape(framed.shape)[inside].copy()


def _add_moved(to: Grid, what: Grid, by: int) -> None:
    """Set in flat `to` what is set in flat `what` shifted by `by` cells in either direction."""
    to[by:] |= what[: len(what) - by]
    to[: len(to) - by] |= what[by:]
