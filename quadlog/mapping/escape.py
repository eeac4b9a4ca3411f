"""The way out when the robot stands where obstacles have been grown over it. [Planning]

A logged robot walks closer to obstacles than the planner would: its cell is
then blocked by the growth alone, and no planner could start there.
"""

from __future__ import annotations

from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.mapping.occupancy import Grid

# Steps from a cell as (dcol, drow), by row, then column.
STEPS = [(dcol, drow) for drow in (-1, 0, 1) for dcol in (-1, 0, 1)]


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
    way = _cheapest_way_out(occupied, blocked, col, row)
    return Escape(way[-1], np.array(way, dtype=np.int32)) if way else None


def _cheapest_way_out(occupied: Grid, blocked: Grid, start_col: int, start_row: int) -> list[tuple[int, int]]:
    """Dijkstra's search to the first unblocked cell: the cells (col, row) of the way, none when there is none.

    Plain Python: growth is some cells deep, so there is little to search.
    """
    rows, cols = occupied.shape
    solid, closed_off = occupied.tobytes(), blocked.tobytes()
    start = start_row * cols + start_col
    cost, came_from = {start: 0}, {start: -1}
    waiting = [(0, start)]
    while waiting:
        at_cost, at = heappop(waiting)
        if at_cost > cost[at]:
            continue
        if not closed_off[at]:
            return _way_to(came_from, at, cols)
        row, col = divmod(at, cols)
        for dcol, drow in STEPS:
            c, r = col + dcol, row + drow
            if not (0 <= r < rows and 0 <= c < cols) or solid[r * cols + c]:
                continue
            diagonal = drow != 0 and dcol != 0
            if diagonal and (solid[row * cols + c] or solid[r * cols + col]):
                continue
            step, step_cost = r * cols + c, at_cost + (14 if diagonal else 10)
            if step not in cost or step_cost < cost[step]:
                cost[step], came_from[step] = step_cost, at
                heappush(waiting, (step_cost, step))
    return []


def _way_to(came_from: dict[int, int], end: int, cols: int) -> list[tuple[int, int]]:
    way, at = [], end
    while at >= 0:
        way.append((at % cols, at // cols))
        at = came_from[at]
    return way[::-1]
