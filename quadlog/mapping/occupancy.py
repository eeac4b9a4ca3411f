"""Points become a grid of occupied cells, and how high what occupies them is."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.mapping.window import Window
from quadlog.messages import Float

Grid = NDArray[np.bool_]


def obstacle_tops(points_m: Float, window: Window, min_points: int) -> NDArray[np.float32]:
    """Height (rows, cols) of the highest of the points (N, 3) in each cell, -inf in cells with too few. [Following]

    A point is x and y in map and its height above the ground. A cell with
    fewer than min_points of them is not occupied. Points outside the window,
    and any that are not finite, count nowhere.
    """
    points_m = np.asarray(points_m, dtype=np.float64)
    rows, cols = window.shape
    return _tops(points_m, window.col0, window.row0, window.cell_m, rows, cols, min_points)


@njit(cache=True)
def _tops(
    points_m: Float, col0: int, row0: int, cell_m: float, rows: int, cols: int, min_points: int
) -> NDArray[np.float32]:
    count = np.zeros((rows, cols), dtype=np.int32)
    top_m = np.full((rows, cols), -np.inf, dtype=np.float32)
    for i in range(len(points_m)):
        # Compared as floats: a huge or NaN coordinate must not reach the cast to an index.
        col = np.floor(points_m[i, 0] / cell_m) - col0
        row = np.floor(points_m[i, 1] / cell_m) - row0
        if col >= 0.0 and col < cols and row >= 0.0 and row < rows:
            count[int(row), int(col)] += 1
            top_m[int(row), int(col)] = max(top_m[int(row), int(col)], points_m[i, 2])
    if min_points > 1:
        top_m = np.where(count >= min_points, top_m, np.float32(-np.inf))
    return top_m
