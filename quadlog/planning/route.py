"""What IA* asks about the route of the plan before: where the robot is on it, whether it still holds, what it costs."""

from __future__ import annotations

import numpy as np
from numba import njit

from quadlog.planning.protocol import Bool, Cells
from quadlog.planning.search_core import octile


@njit(cache=True)
def is_legal_step(blocked: Bool, col: int, row: int, next_col: int, next_row: int, corner_cutting: bool) -> bool:
    """Whether one step between neighbouring cells ends in a free cell and keeps the rule for corners."""
    if blocked[next_row, next_col]:
        return False
    diagonal = col != next_col and row != next_row
    return corner_cutting or not diagonal or not (blocked[row, next_col] or blocked[next_row, col])


@njit(cache=True)
def count_in_window(cells: Cells, shape: tuple[int, int]) -> int:
    """How many cells, from the first on, lie in the window before the route leaves it."""
    for i in range(len(cells)):
        if not (0 <= cells[i, 0] < shape[1] and 0 <= cells[i, 1] < shape[0]):
            return i
    return len(cells)


@njit(cache=True)
def is_legal(blocked: Bool, cells: Cells, corner_cutting: bool) -> bool:
    """Whether every cell of a path inside the window is free and every step allowed."""
    if len(cells) > 0 and blocked[cells[0, 1], cells[0, 0]]:
        return False
    for i in range(1, len(cells)):
        col, row, next_col, next_row = cells[i - 1, 0], cells[i - 1, 1], cells[i, 0], cells[i, 1]
        if not is_legal_step(blocked, col, row, next_col, next_row, corner_cutting):
            return False
    return True


@njit(cache=True)
def nearest_index(cells: Cells, col: int, row: int) -> int:
    """Index of the cell of least octile distance; among equals the last, which leaves the least to walk."""
    best, best_distance = 0, octile(cells[0, 0] - col, cells[0, 1] - row)
    for i in range(1, len(cells)):
        distance = octile(cells[i, 0] - col, cells[i, 1] - row)
        if distance <= best_distance:
            best, best_distance = i, distance
    return best


@njit(cache=True)
def direct_way(col: int, row: int, to_col: int, to_row: int, diagonal_first: bool) -> Cells:
    """(L, 2) int32 cells from one cell to another, both included: diagonal steps on one side, straight on the other."""
    across, along = abs(to_col - col), abs(to_row - row)
    diagonals, straights = min(across, along), abs(across - along)
    cells = np.empty((diagonals + straights + 1, 2), dtype=np.int32)
    cells[0, 0], cells[0, 1] = col, row
    for i in range(1, len(cells)):
        is_diagonal = i <= diagonals if diagonal_first else i > straights
        if is_diagonal or across > along:
            col += 1 if to_col > col else -1
        if is_diagonal or along > across:
            row += 1 if to_row > row else -1
        cells[i, 0], cells[i, 1] = col, row
    return cells


@njit(cache=True)
def best_waypoint(cells: Cells, goal_col: int, goal_row: int) -> tuple[int, int]:
    """(index, cost from the first cell) of the cell with the least f, looking from the end of the path.

    f = g + 10 (|dx| + |dy|) [Planning] eq. 2-4, with the unit of eq. 3 as the erratum has it:
    without the 10, f would rise at every step and nothing would ever be kept.
    """
    g = np.zeros(len(cells), dtype=np.int64)
    for i in range(1, len(cells)):
        g[i] = g[i - 1] + octile(cells[i, 0] - cells[i - 1, 0], cells[i, 1] - cells[i - 1, 1])
    best, best_f = -1, np.int64(0)
    for i in range(len(cells) - 1, -1, -1):
        f = g[i] + 10 * (abs(goal_col - cells[i, 0]) + abs(goal_row - cells[i, 1]))
        if best < 0 or f < best_f:
            best, best_f = i, f
    return best, g[best]
