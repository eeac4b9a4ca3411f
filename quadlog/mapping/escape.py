"""The way out when the robot stands where obstacles have been grown over it. [Planning]

A logged robot walks closer to obstacles than the planner would: its cell is
then blocked by the growth alone, and no planner could start there.
"""

from __future__ import annotations

from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.mapping.occupancy import Grid
from quadlog.messages import Int


class Escape(NamedTuple):
    """The unblocked cell (col, row) to plan from, and the way there, (L, 2) int32, from the robot's cell to it."""

    cell: tuple[int, int]
    path: NDArray[np.int32]


def escape_start(occupied: Grid, blocked: Grid, start_cell: tuple[int, int]) -> Escape | None:
    """The nearest unblocked cell along a way that crosses no occupied cell; the start itself when it is not blocked.

    `blocked` is `occupied` after inflation. Steps cost 10 and 14, and a
    diagonal one needs both cells beside it unoccupied, as in planning. The
    robot's own cell counts as free even if something was seen in it: it
    stands there. None when the start lies outside the grid or is walled in.
    """
    rows, cols = blocked.shape
    col, row = start_cell
    if not (0 <= col < cols and 0 <= row < rows):
        return None
    indices = _cheapest_way_out(occupied, blocked, col, row)
    if len(indices) == 0:
        return None
    path = np.stack([indices % cols, indices // cols], axis=1).astype(np.int32)
    return Escape((int(path[-1, 0]), int(path[-1, 1])), path)


@njit(cache=True)
def _cheapest_way_out(occupied: Grid, blocked: Grid, start_col: int, start_row: int) -> Int:
    """Dijkstra's search to the first unblocked cell: flat indices of the way, empty when there is none."""
    rows, cols = occupied.shape
    cost = np.full(rows * cols, np.iinfo(np.int64).max)
    came_from = np.full(rows * cols, -1, dtype=np.int64)
    start = start_row * cols + start_col
    cost[start] = 0
    waiting = [(np.int64(0), np.int64(start))]
    while len(waiting) > 0:
        at_cost, at = heappop(waiting)
        if at_cost > cost[at]:
            continue
        row, col = divmod(at, cols)
        if not blocked[row, col]:
            return _way_to(came_from, at)
        for drow in range(-1, 2):
            for dcol in range(-1, 2):
                r, c = row + drow, col + dcol
                if not (0 <= r < rows and 0 <= c < cols) or occupied[r, c]:
                    continue
                if drow != 0 and dcol != 0 and (occupied[row, c] or occupied[r, col]):
                    continue
                step_cost = at_cost + (14 if drow != 0 and dcol != 0 else 10)
                step = r * cols + c
                if step_cost < cost[step]:
                    cost[step], came_from[step] = step_cost, at
                    heappush(waiting, (step_cost, step))
    return np.empty(0, dtype=np.int64)


@njit(cache=True)
def _way_to(came_from: Int, end: np.int64) -> Int:
    length, at = 1, end
    while came_from[at] >= 0:
        length, at = length + 1, came_from[at]
    way = np.empty(length, dtype=np.int64)
    at = end
    for i in range(length - 1, -1, -1):
        way[i], at = at, came_from[at]
    return way
