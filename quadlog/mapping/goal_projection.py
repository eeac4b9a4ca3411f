"""Obstacles grown by the robot's size, so that planning may treat it as a point; start and goal moved off them.

A logged robot walks closer to obstacles than the planner would: its cell is
then blocked by the growth alone, and no planner could start there. [Planning]
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, partial
from heapq import heappop, heappush
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from quadlog.mapping.grid import Grid, Window
from quadlog.messages import Float, Int


def inflate(occupied: Grid, radius_cells: float, distance: Callable[[int, int], float] = math.hypot) -> Grid:
    """Every cell within radius_cells of an occupied one, by the distance of columns and rows between their centres."""
    if not occupied.any():
        return occupied.copy()
    # Slightly more, so that a radius of exactly n cells, computed as metres / metres, reaches the n-th cell.
    reach = radius_cells + 1e-9
    grown, wide, width = occupied.copy(), occupied.copy(), 0
    # Rows of the shape from its edge to its middle, each at least as wide as the last: much faster than distances.
    for up in range(int(min(reach, len(occupied))), -1, -1):
        while distance(width + 1, up) <= reach and width < occupied.shape[1]:
            width += 1
            wide[:, width:] |= occupied[:, :-width]
            wide[:, :-width] |= occupied[:, width:]
        grown[up:] |= wide[: len(wide) - up]
        grown[: len(wide) - up] |= wide[up:]
    return grown


INFLATIONS: dict[str, Callable[[Grid, float], Grid]] = {"euclidean": inflate, "square": partial(inflate, distance=max)}
"""The shapes by which obstacles grow: discs, and squares of no more columns or rows than the radius. [Planning]"""

Cell = tuple[int, int]
# Steps from a cell as (dcol, drow), by row, then column.
STEPS = [(dcol, drow) for drow in (-1, 0, 1) for dcol in (-1, 0, 1)]
DETOUR = 20
"""Two straight steps: obstacles grow by three cells in [Planning], so that this is about the depth of the growth."""


def escape_start(occupied: Grid, blocked: Grid, start_cell: Cell, goal_cell: Cell) -> NDArray[np.int32] | None:
    """The way (L, 2) of cells from the start, in the grid, to an unblocked one near by that crosses no occupied cell.

    It is the start alone when that is not blocked, and None when it is walled in. `blocked` is `occupied` after
    inflation. Steps cost 10 and 14, and a diagonal one needs both cells beside it unoccupied, as in planning. The
    robot's own cell counts as free even if something was seen in it: it stands there. Of the cells that cost at most
    DETOUR more than the nearest one, it leads to that with the shortest way on to the goal, (col, row) anywhere, over
    free cells, the way out included: a robot should not turn back to get out.
    """
    # Dijkstra's search in plain Python: growth is a few cells deep, so there is little to search.
    (rows, cols), solid, closed_off = blocked.shape, occupied.tobytes(), blocked.tobytes()
    start = start_cell[1] * cols + start_cell[0]
    cost, came_from = {start: 0}, {start: -1}
    waiting = [(0, start)]
    most, best = math.inf, (math.inf, -1)
    while waiting and waiting[0][0] <= most:
        at_cost, at = heappop(waiting)
        if at_cost > cost[at]:
            continue
        row, col = divmod(at, cols)
        if not closed_off[at]:
            along, across = abs(goal_cell[0] - col), abs(goal_cell[1] - row)
            total = at_cost + 10 * max(along, across) + 4 * min(along, across)
            most = min(most, at_cost + DETOUR if at != start else -1)
            best = min(best, (total, at), key=itemgetter(0))
            continue
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
    way, at = [], best[1]
    while at >= 0:
        way.append((at % cols, at // cols))
        at = came_from[at]
    return np.array(way[::-1], dtype=np.int32) if way else None


def project_goal(blocked: Grid, window: Window, start_cell: Cell, goal_xy_m: Float) -> Cell:
    """The reachable cell to plan to, from a free one, for a finite goal (2,) in map. [Planning, section 1.2]

    - A goal in the window, on a cell that can be reached, is its own cell.
    - Beyond the window, the line from the robot to the goal crosses its margin
      in a cell; from there the margin is walked both ways to the nearest cell
      that can be reached.
    - Else, and where no cell of the margin can be reached, it is the
      reachable cell nearest to the goal's, or to that of the crossing.
    Ties go to the counter-clockwise side of the margin, else to the lower row, then column.
    """
    # A diagonal step needs both cells beside it free, so two straight steps do as well.
    regions, _ = ndimage.label(~blocked)
    reachable: Grid = regions == regions[start_cell[1], start_cell[0]]
    cell = window.cell_of(goal_xy_m)
    if not window.contains(cell):
        cell = _crossing(window, start_cell, goal_xy_m)
        margin = _margin(window.shape)
        at = np.flatnonzero((margin == cell).all(axis=1))[0]
        candidates = np.flatnonzero(reachable[margin[:, 1], margin[:, 0]])
        ahead = (candidates - at) % len(margin)
        steps = np.minimum(2 * ahead, 2 * (len(margin) - ahead) + 1)  # odd when clockwise: loses ties
        if len(candidates):
            cell = margin[candidates[np.argmin(steps)]]
    if not reachable[cell[1], cell[0]]:
        rows, cols = np.nonzero(reachable)
        nearest = np.argmin((cols - cell[0]) ** 2 + (rows - cell[1]) ** 2)
        cell = np.array([cols[nearest], rows[nearest]])
    return int(cell[0]), int(cell[1])


def _crossing(window: Window, start_cell: Cell, goal_xy_m: Float) -> Int:
    """The cell of the margin where the line from the start's centre to a goal outside leaves the window."""
    size, start = np.array(window.shape[::-1]), np.array(start_cell) + 0.5
    way = goal_xy_m / window.cell_m - [window.col0, window.row0] - start
    with np.errstate(divide="ignore"):
        # The line's parameter, 0 at the start and 1 at the goal, at the side it meets first.
        leaving = np.min(np.where(way < 0, -start, size - start) / way)
    return np.clip(np.floor(start + leaving * way), 0, size - 1).astype(np.int64)


@cache
def _margin(shape: tuple[int, ...]) -> Int:
    """The window's outermost cells (M, 2), each once, counter-clockwise from (0, 0)."""
    rows, cols = shape
    lower, right = [(col, 0) for col in range(cols)], [(cols - 1, row) for row in range(rows)]
    upper, left = [(col, rows - 1) for col in range(cols)[::-1]], [(0, row) for row in range(rows)[::-1]]
    return np.array(list(dict.fromkeys([*lower, *right, *upper, *left])))
