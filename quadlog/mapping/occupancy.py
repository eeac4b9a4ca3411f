"""Points become a grid of occupied cells, and how high what occupies them is."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.mapping.window import Window
from quadlog.messages import Float, Float32

Grid = NDArray[np.bool_]


def obstacle_tops(points_m: Float, window: Window, min_points: int) -> NDArray[np.float32]:
    """Height (rows, cols) of the highest of the points (N, 3) in each cell, -inf in cells with too few. [Following]

    A point is x and y in map and its height above the ground. A cell with
    fewer than min_points of them is not occupied. Points outside the window,
    and any that are not finite, count nowhere.
    """
    top_m = np.full(window.shape, -np.inf, dtype=np.float32)
    count = np.zeros(window.shape, dtype=np.int32)
    _raise_tops(np.asarray(points_m, dtype=np.float64), window.col0, window.row0, window.cell_m, count, top_m)
    if min_points > 1:
        top_m[count < min_points] = -np.inf
    return top_m


@njit(cache=True, error_model="numpy")
def _raise_tops(points_m: Float, col0: int, row0: int, cell_m: float, count: NDArray[np.int32], top_m: Float32) -> None:
    rows, cols = top_m.shape
    for i in range(len(points_m)):
        # Compared as floats: a huge or NaN coordinate must not reach the cast to an index.
        col = np.floor(points_m[i, 0] / cell_m) - col0
        row = np.floor(points_m[i, 1] / cell_m) - row0
        if col >= 0.0 and col < cols and row >= 0.0 and row < rows:
            count[int(row), int(col)] += 1
            top_m[int(row), int(col)] = max(top_m[int(row), int(col)], points_m[i, 2])
