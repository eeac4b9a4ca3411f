"""The compiled A* for rules that the bucket queue does not support: any heuristic, exact costs, either tie, danger.

OPEN is a binary heap that holds each cell once and knows where. Cells once
closed stay closed, as the papers print it; with the consistent octile or zero
heuristic and no charge for leaving a cell, nothing better could come to them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inlined, kernel
from quadlog.planning.protocol import Bool, Cell, Cells, Plan, is_usable, no_plan
from quadlog.planning.rules import Rules
from quadlog.planning.search.grid_steps import (
    FIRST_DIAGONAL,
    REANCHOR_CELLS,
    STEP_COL,
    STEP_ROW,
    join,
    kept_route,
    legal_steps,
)


@inlined
def is_less(f, tie, than_f, than_tie):  # type: ignore[no-untyped-def]
    return f < than_f or (f == than_f and tie < than_tie)


@inlined
def _put(heap, keys, place_of, place, cell, f, tie):  # type: ignore[no-untyped-def]
    heap[place], keys[place, 0], keys[place, 1] = cell, f, tie
    place_of[cell] = place + 1


@inlined
def rise(heap, keys, place_of, place, cell, f, tie):  # type: ignore[no-untyped-def]
    """Puts a cell at a free place, or nearer to the top where its key belongs."""
    while place > 0:
        above = (place - 1) >> 1
        if not is_less(f, tie, keys[above, 0], keys[above, 1]):
            break
        _put(heap, keys, place_of, place, heap[above], keys[above, 0], keys[above, 1])
        place = above
    _put(heap, keys, place_of, place, cell, f, tie)


@inlined
def take(heap, keys, place_of, size):  # type: ignore[no-untyped-def]
    """The first of `size` cells, taken out; the last one sinks from its place to where its key belongs."""
    first, last, place = heap[0], size - 1, 0
    cell, f, tie = heap[last], keys[last, 0], keys[last, 1]
    while True:
        child = 2 * place + 1
        if child + 1 < last and is_less(keys[child + 1, 0], keys[child + 1, 1], keys[child, 0], keys[child, 1]):
            child += 1
        if child >= last or not is_less(keys[child, 0], keys[child, 1], f, tie):
            break
        _put(heap, keys, place_of, place, heap[child], keys[child, 0], keys[child, 1])
        place = child
    _put(heap, keys, place_of, place, cell, f, tie)
    return first


# Entries of a search's parameters: what steps cost, the heuristic's two factors, what dear cells cost, the tie's sign.
STRAIGHT, DIAGONAL, ALONG, ACROSS, ENTERING, LEAVING, SAME_LEVEL, TIE = range(8)
# Where a cell stands in OPEN from 1; 0 when not, or one of these.
CLOSED = -1
_kept_route, _join = kernel(kept_route), kernel(join)


@dataclass(frozen=True, slots=True)
class Danger:
    """What makes cells dear, in thousandths of a straight step.

    levels (rows, cols) int8, 0 where a cell is as any other. entering, leaving: charged and given back for each
    level of the cell entered and left; same_level: given back for a step between cells of one level.
    """

    levels: NDArray[np.int8]
    entering: int
    leaving: int
    same_level: int


class HeapSearch:
    """Best-first search by any rules, its work arrays kept from call to call: 38 bytes a cell."""

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self._shape = (0, 0)
        self._kept: Cells = np.empty((0, 2), dtype=np.int32)

    def search(self, blocked: Bool, start: Cell, goal: Cell, danger: Danger | None = None) -> Plan:
        """The cheapest path from start to goal (col, row) on blocked (rows, cols), as far as the heuristic allows."""
        if not (is_usable(blocked, start) and is_usable(blocked, goal)):
            return no_plan()
        self._prepare(blocked, danger)
        return self._found(start, goal, danger) or no_plan()

    def extend(
        self, blocked: Bool, route: Cells, shift: Cell, start: Cell, goal: Cell, from_end: bool = False
    ) -> Plan | None:
        """As BucketSearch.extend."""
        if not (is_usable(blocked, start) and is_usable(blocked, goal)):
            return None
        self._prepare(blocked, None)
        if len(self._kept) < len(route) + REANCHOR_CELLS:
            self._kept = np.empty((2 * len(route) + REANCHOR_CELLS, 2), dtype=np.int32)
        cutting, units = self._rules.corner_cutting, self._rules.step_units
        kept, linking, *steps = _kept_route(blocked, route, *shift, start, goal, cutting, units, self._kept, from_end)
        return self._found(self._kept[kept - 1], goal, None, kept, linking, steps) if kept else None

    def _found(
        self, start: Any, goal: Cell, danger: Danger | None, kept: int = 0, linking: int = 0, steps: Any = (0, 0)
    ) -> Plan | None:
        """The path from start on, behind what is kept of a route with these steps; None where there is no room."""
        width = self._shape[1]
        first, last = ((int(row) + 1) * width + int(col) + 1 for col, row in (start, goal))
        length, straights, diagonals, expanded, generated, touched = _search(
            *self._work, self._parameters(danger), width, first, last, self._rules.corner_cutting
        )
        if kept:
            length = _join(self._way, length, self._kept, kept)
        if length <= 0:
            return None if length < 0 else no_plan(expanded, generated, touched, from_scratch=not kept)
        cost = self._rules.cost_of(straights + steps[0], diagonals + steps[1])
        reused = max(kept - linking, 0)
        return Plan(True, self._way[-length:].copy(), cost, expanded, generated, touched, not kept, reused)

    def _parameters(self, danger: Danger | None) -> NDArray[np.int64]:
        # Tenths a hundred times finer, so that a thousandth of a straight step is a whole number. Exact costs are fine
        # enough: finer, they would overflow on long ways through a large map.
        finer = 100 if self._rules.costs == "integer" else 1
        steps = [finer * each for each in (*self._rules.step_units, *self._rules.heuristic_units)]
        dear = (0, 0, 0) if danger is None else (danger.entering, danger.leaving, danger.same_level)
        charges = (each * steps[STRAIGHT] // 1000 for each in dear)
        return np.array([*steps, *charges, -1 if self._rules.ties == "larger_g" else 1], dtype=np.int64)

    def _prepare(self, blocked: Bool, danger: Danger | None) -> None:
        shape = (blocked.shape[0] + 2, blocked.shape[1] + 2)
        if self._shape != shape:
            self._shape, count = shape, shape[0] * shape[1]
            self._padded, self._levels = np.ones(shape, dtype=np.uint8), np.zeros(shape, dtype=np.int8)
            self._place = np.zeros(count, dtype=np.int32)
            g, keys = np.empty(count, dtype=np.int64), np.empty((count, 2), dtype=np.int64)
            heap, parent_step = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.int8)
            # The same memory: OPEN is no longer needed when the way is written down.
            self._way = keys.reshape(-1).view(np.int32).reshape(-1, 2)[:count]
            flat = self._padded.reshape(-1), self._levels.reshape(-1)
            self._work = (*flat, self._place, g, keys, heap, parent_step, self._way)
        else:
            self._place[:] = 0
        self._padded[1:-1, 1:-1] = blocked
        self._levels[1:-1, 1:-1] = 0 if danger is None else danger.levels


@inlined
def walk_back(parent_step, way, width, start, goal):  # type: ignore[no-untyped-def]
    """Writes the path to the last rows of way, (col, row) from start to goal: (its cells, diagonal steps)."""
    cell, first, diagonals = goal, len(way), 0
    while True:
        row, first = cell // width, first - 1
        way[first, 0], way[first, 1] = cell - row * width - 1, row - 1
        if cell == start:
            return len(way) - first, diagonals
        k = parent_step[cell]
        diagonals += k >= FIRST_DIAGONAL
        cell -= STEP_ROW[k] * width + STEP_COL[k]


@kernel
def _search(  # type: ignore[no-untyped-def]
    padded, levels, place_of, best_g, keys, heap, parent_step, way, parameters, width, start, goal, cutting
):
    """(cells of the path, its straight and diagonal steps, expanded, generated, touched); way's last rows hold it.

    Cells are flat indices in the grid with its border.
    """
    straight, diagonal, along, across = (
        parameters[STRAIGHT],
        parameters[DIAGONAL],
        parameters[ALONG],
        parameters[ACROSS],
    )
    entering, leaving, same_level = parameters[ENTERING], parameters[LEAVING], parameters[SAME_LEVEL]
    tie, goal_row = parameters[TIE], goal // width
    goal_col = goal - goal_row * width
    best_g[start] = 0
    size, expanded, generated, touched = 1, 0, 1, 0
    heap[0], keys[0, 0], keys[0, 1] = start, 0, 0
    while size > 0:
        cell = take(heap, keys, place_of, size)
        size -= 1
        place_of[cell] = CLOSED
        expanded += 1
        if cell == goal:
            length, diagonals = walk_back(parent_step, way, width, start, goal)
            return length, length - 1 - diagonals, diagonals, expanded, generated, touched
        row, level = cell // width, levels[cell]
        left_g = best_g[cell] - leaving * level
        row_to_go, col_to_go = goal_row - row, goal_col - (cell - row * width)
        legal = legal_steps(padded, cell, width, cutting)
        for k in range(8):
            if not (legal >> k) & 1:
                continue
            touched += 1
            neighbour = cell + STEP_ROW[k] * width + STEP_COL[k]
            place = place_of[neighbour]
            if place == CLOSED:
                continue
            g = left_g + (straight if k < FIRST_DIAGONAL else diagonal) + entering * levels[neighbour]
            if levels[neighbour] == level:
                g -= same_level
            if place > 0 and g >= best_g[neighbour]:
                continue
            best_g[neighbour], parent_step[neighbour] = g, k
            cols, rows = abs(col_to_go - STEP_COL[k]), abs(row_to_go - STEP_ROW[k])
            f = g + along * max(cols, rows) + across * min(cols, rows)
            if place == 0:
                generated += 1
                size += 1
                place = size
            rise(heap, keys, place_of, place - 1, neighbour, f, tie * g)
    return 0, 0, 0, expanded, generated, touched
