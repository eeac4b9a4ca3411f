"""What IA* asks about the route of the plan before: where the robot is on it, whether it still holds, what it costs."""

from __future__ import annotations

import numpy as np
from numba import njit

from quadlog.planning.protocol import Bool, Cells
from quadlog.planning.search_core import octile


@njit(cache=True, error_model="numpy")
def rest_of_route(blocked: Bool, cells: Cells, col: int, row: int, corner_cutting: bool) -> tuple[int, int]:
    """(first, end) of a route's cells (L, 2), some of them outside the window, that are left for a robot in a cell.

    first: the cell of least octile distance, among equals the last, which leaves the least to walk.
    end: behind the last cell before the route leaves the window, or first when it cannot be walked that far:
    a cell of it is blocked, or a step cuts a corner that must not be.
    """
    rows, cols = blocked.shape
    first, least = 0, 0
    for i in range(len(cells)):
        distance = octile(cells[i, 0] - col, cells[i, 1] - row)
        if i == 0 or distance <= least:
            first, least = i, distance
    end, before_col, before_row = first, cells[first, 0], cells[first, 1]
    while end < len(cells):
        at_col, at_row = cells[end, 0], cells[end, 1]
        if at_col < 0 or at_row < 0 or at_col >= cols or at_row >= rows:
            break
        if blocked[at_row, at_col]:
            return first, first
        # Beside a straight step these are the two cells it joins: free, or it would not have come to this.
        if not corner_cutting and (blocked[before_row, at_col] or blocked[at_row, before_col]):
            return first, first
        end, before_col, before_row = end + 1, at_col, at_row
    return first, end


def direct_way(col: int, row: int, to_col: int, to_row: int, diagonal_first: bool) -> Cells:
    """(L, 2) int32 cells from one cell to another, both included: diagonal steps on one side, straight on the other."""
    across, along = abs(to_col - col), abs(to_row - row)
    diagonals, straights = min(across, along), abs(across - along)
    cells = [(col, row)]
    for i in range(1, diagonals + straights + 1):
        is_diagonal = i <= diagonals if diagonal_first else i > straights
        if is_diagonal or across > along:
            col += 1 if to_col > col else -1
        if is_diagonal or along > across:
            row += 1 if to_row > row else -1
        cells.append((col, row))
    return np.array(cells, dtype=np.int32)


@njit(cache=True, error_model="numpy")
def best_waypoint(cells: Cells, goal_col: int, goal_row: int) -> tuple[int, int]:
    """(index, cost from the first cell) of the cell with the least f, among equals the last, of a path (L, 2), L >= 1.

    f = g + 10 (|dx| + |dy|) [Planning] eq. 2-4, with the unit of eq. 3 as the erratum has it:
    without the 10, f would rise at every step and nothing would ever be kept.
    """
    g, best, best_g, best_f = 0, 0, 0, 0
    for i in range(len(cells)):
        col, row = cells[i, 0], cells[i, 1]
        if i > 0:
            g += octile(col - cells[i - 1, 0], row - cells[i - 1, 1])
        f = g + 10 * (abs(goal_col - col) + abs(goal_row - row))
        if i == 0 or f <= best_f:
            best, best_g, best_f = i, g, f
    return best, best_g
