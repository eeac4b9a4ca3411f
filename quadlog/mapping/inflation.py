"""Obstacles grow by the robot's size, so that planning may treat the robot as a point."""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage

from quadlog.mapping.grid import Grid


def inflate(occupied: Grid, radius_cells: float) -> Grid:
    """Every cell whose centre lies within radius_cells of an occupied cell's centre. Raises ValueError below 0."""
    _check(radius_cells)
    if not occupied.any():
        return occupied.copy()
    # Slightly more, so that a radius of exactly n cells, computed as metres / metres, reaches the n-th cell.
    reach = radius_cells + 1e-9
    grown, wide, width = occupied.copy(), occupied.copy(), 0
    # Rows of the disc from its edge to its middle, each at least as wide as the last: much faster than distances.
    for up in range(int(min(reach, len(occupied))), -1, -1):
        while math.hypot(width + 1, up) <= reach and width < occupied.shape[1]:
            width += 1
            wide[:, width:] |= occupied[:, :-width]
            wide[:, :-width] |= occupied[:, width:]
        grown[up:] |= wide[: len(wide) - up]
        grown[: len(wide) - up] |= wide[up:]
    return grown


def inflate_square(occupied: Grid, radius_cells: float) -> Grid:
    """Every cell no more than radius_cells columns and rows from an occupied cell. [Planning] ValueError below 0."""
    _check(radius_cells)
    edge = 2 * int(min(radius_cells + 1e-9, max(occupied.shape))) + 1
    grown: Grid = ndimage.maximum_filter(occupied.view(np.uint8), edge, mode="constant").view(np.bool_)
    return grown


INFLATIONS = {"euclidean": inflate, "square": inflate_square}
"""The shapes by which obstacles grow."""


def _check(radius_cells: float) -> None:
    if not radius_cells >= 0:
        raise ValueError(f"the inflation radius must be at least 0 cells, not {radius_cells}")
