"""Points become a grid of occupied cells."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.mapping.window import Window
from quadlog.messages import Float

Grid = NDArray[np.bool_]


def occupancy(points_xy_m: Float, window: Window, min_points: int) -> Grid:
    """Cells (rows, cols) bool that hold at least min_points of the points (N, 2) in map. [Following]

    Points outside the window, and any that are not finite, count nowhere.
    """
    points_xy_m = np.asarray(points_xy_m, dtype=np.float64)
    rows, cols = window.shape
    occupied: Grid = _count(points_xy_m, window.col0, window.row0, window.cell_m, rows, cols) >= min_points
    return occupied


@njit(cache=True)
def _count(xy_m: Float, col0: int, row0: int, cell_m: float, rows: int, cols: int) -> NDArray[np.int32]:
    count = np.zeros((rows, cols), dtype=np.int32)
    for i in range(len(xy_m)):
        # Compared as floats: a huge or NaN coordinate must not reach the cast to an index.
        col = np.floor(xy_m[i, 0] / cell_m) - col0
        row = np.floor(xy_m[i, 1] / cell_m) - row0
        if col >= 0.0 and col < cols and row >= 0.0 and row < rows:
            count[int(row), int(col)] += 1
    return count
