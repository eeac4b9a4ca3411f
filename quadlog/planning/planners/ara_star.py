"""ARA*: a quick path by an inflated heuristic first, then better and better ones from what is known [ARA*]."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inlined, kernel
from quadlog.planning.protocol import Bool, Cell, Plan, is_usable, no_plan
from quadlog.planning.rules import USUAL, Rules
from quadlog.planning.search.grid_steps import FIRST_DIAGONAL, STEP_COL, STEP_ROW, legal_steps
from quadlog.planning.search.heap_search import rise, take, walk_back

# By how much the heuristic is inflated in one round after the other, in tenths; the last one's path is the cheapest.
WEIGHTS_TENTHS = (25, 20, 15, 10)
FAR = 2**62


class ARAStar:
    """Anytime search, run to its end on every call: optimal, and it remembers nothing between calls. See Planner.

    `expanded` are closed cells: a cell may be closed once in each round, and every time counts; the goal counts in each
    round that finds a cheaper way to it, as A* counts its goal. `generated` are distinct cells.
    """

    name: ClassVar[str] = "ara_star"
    incremental: ClassVar[bool] = False

    def __init__(self, rules: Rules = USUAL) -> None:
        self.rules = replace(rules, heuristic="octile")
        self._shape = (0, 0)
        self._weights = np.array(WEIGHTS_TENTHS)

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """The path of the last round, the cheapest."""
        if not (is_usable(blocked, start) and is_usable(blocked, goal)):
            return no_plan()
        shape = (blocked.shape[0] + 2, blocked.shape[1] + 2)
        if self._shape != shape:
            self._prepare(shape)
        self._padded[1:-1, 1:-1] = blocked
        first, last = ((row + 1) * shape[1] + col + 1 for col, row in (start, goal))
        tie = -1 if self.rules.ties == "larger_g" else 1
        length, diagonals, expanded, generated, touched = _improve(
            *self._work, self._weights, self.rules.step_units, tie, shape[1], first, last, self.rules.corner_cutting
        )
        if length == 0:
            return no_plan(expanded, generated, touched)
        cells = self._way[len(self._way) - length :].copy()
        cost = self.rules.cost_of(length - 1 - diagonals, diagonals)
        return Plan(True, cells, cost, expanded, generated, touched, from_scratch=True, reused_cells=0)

    def reset(self) -> None:
        """Nothing to forget."""

    def _prepare(self, shape: tuple[int, int]) -> None:
        self._shape, count = shape, shape[0] * shape[1]
        self._padded = np.ones(shape, dtype=np.uint8)
        place_of, closed_in = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.int8)
        g, keys = np.empty(count, dtype=np.int64), np.empty((count, 2), dtype=np.int64)
        heap, waiting = np.empty((2, count), dtype=np.int32)
        parent_step: NDArray[np.int8] = np.empty(count, dtype=np.int8)
        # The same memory: OPEN is no longer needed when the way is written down.
        self._way = keys.reshape(-1).view(np.int32).reshape(-1, 2)[:count]
        flat = self._padded.reshape(-1)
        self._work = (flat, place_of, closed_in, g, keys, heap, waiting, parent_step, self._way)


@inlined
def _estimate(cell, goal, width, units):  # type: ignore[no-untyped-def]
    row, goal_row = cell // width, goal // width
    along, across = abs(goal_row - row), abs((goal - goal_row * width) - (cell - row * width))
    return units[0] * abs(across - along) + units[1] * min(across, along)


@inlined
def _open_again(heap, waiting, count, keys, place_of, best_g, weight, tie, goal, width, units):  # type: ignore[no-untyped-def]
    """Makes OPEN of the cells in `waiting`, with keys of this round's weight."""
    for i in range(count):
        cell = waiting[i]
        f = 10 * best_g[cell] + weight * _estimate(cell, goal, width, units)
        rise(heap, keys, place_of, i, cell, f, tie * best_g[cell])


@kernel
def _improve(  # type: ignore[no-untyped-def]
    padded,
    place_of,
    closed_in,
    best_g,
    keys,
    heap,
    waiting,
    parent_step,
    way,
    weights,
    units,
    tie,
    width,
    start,
    goal,
    cutting,
):
    """(cells of the path, its diagonal steps, expanded, generated, touched); way's last rows hold the path.

    closed_in: the last round, from 1, in which a cell was expanded. A cell that gets cheaper after that, in the same
    round, waits for the next one.
    """
    place_of[:], closed_in[:], best_g[:] = 0, 0, FAR
    best_g[start], waiting[0] = 0, start
    inconsistent, expanded, generated, touched = 1, 0, 1, 0
    size = 0
    for turn in range(1, len(weights) + 1):
        weight = weights[turn - 1]
        for i in range(size):
            waiting[inconsistent + i] = heap[i]
        size += inconsistent
        _open_again(heap, waiting, size, keys, place_of, best_g, weight, tie, goal, width, units)
        inconsistent, best_before = 0, best_g[goal]
        while size > 0 and keys[0, 0] < 10 * min(best_g[goal], FAR // 16):
            cell = take(heap, keys, place_of, size)
            size -= 1
            place_of[cell] = 0
            closed_in[cell] = turn
            expanded += 1
            legal = legal_steps(padded, cell, width, cutting)
            for k in range(8):
                if not (legal >> k) & 1:
                    continue
                touched += 1
                neighbour = cell + STEP_ROW[k] * width + STEP_COL[k]
                g = best_g[cell] + (units[0] if k < FIRST_DIAGONAL else units[1])
                if g >= best_g[neighbour]:
                    continue
                generated += best_g[neighbour] == FAR
                if closed_in[neighbour] == turn:
                    # Once is enough: it waits already when it got cheaper before in this round.
                    if place_of[neighbour] == 0:
                        waiting[inconsistent] = neighbour
                        inconsistent += 1
                        place_of[neighbour] = -1
                    best_g[neighbour], parent_step[neighbour] = g, k
                    continue
                best_g[neighbour], parent_step[neighbour] = g, k
                f = 10 * g + weight * _estimate(neighbour, goal, width, units)
                if place_of[neighbour] == 0:
                    size += 1
                    place_of[neighbour] = size
                rise(heap, keys, place_of, place_of[neighbour] - 1, neighbour, f, tie * g)
        if best_g[goal] == FAR:
            break
        # Also where start and goal are one cell, whose cost never changes.
        expanded += best_g[goal] < best_before or (turn == 1 and start == goal)
    if best_g[goal] == FAR:
        return 0, 0, expanded, generated, touched
    length, diagonals = walk_back(parent_step, way, width, start, goal)
    return length, diagonals, expanded, generated, touched
