"""The compiled A* under the planners: costs 10/14, octile heuristic, bucket queue, ties to the larger g; and the
choice between it and the heap.

Why it is fast. All costs and heuristics are even, and with the consistent
octile heuristic f grows by at most 28 a step, so OPEN is a ring of 16 lists
(f/2 mod 16) threaded through the cells themselves: no heap, no stale entries.
The list of the smallest f is sorted by g once, when its turn comes. Successors
with the same f have a larger g than everything in it, so they go on top and it
stays sorted: ties go to the larger g exactly. A stamp per cell separates this
search's values from older ones, so nothing is cleared between calls. A border
of blocked cells around the grid spares the bounds checks.

It is one kernel that allocates nothing, with its helpers inlined as they are
typed: apart, each would cost as much to compile again as it does together.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inlined, inner, kernel
from quadlog.planning.protocol import Bool, Cell, Cells, Plan, is_usable, no_plan
from quadlog.planning.rules import Rules
from quadlog.planning.search.grid_steps import (
    REANCHOR_CELLS,
    STEP_COL,
    STEP_COST,
    STEP_ROW,
    join,
    kept_route,
    legal_steps,
    octile,
)
from quadlog.planning.search.heap_search import HeapSearch, walk_back

RING = 16
# Columns of the per-cell record: best cost, stamp (2 * generation, + 1 when closed), list neighbours.
G, STAMP, NEXT, PREVIOUS = 0, 1, 2, 3
MAX_GENERATION = 2**30 - 1
# For a search without a route to extend.
_NO_MAP: Bool = np.ones((1, 1), dtype=np.bool_)
_NO_ROUTE: Cells = np.empty((0, 2), dtype=np.int32)


class BucketSearch:
    """A* with its work arrays kept from call to call: 34 bytes a cell, allocated as pages are touched."""

    def __init__(self, corner_cutting: bool = False) -> None:
        self._corner_cutting = corner_cutting
        self._padded: NDArray[np.uint8] = np.ones((0, 0), dtype=np.uint8)
        self._generation = 0
        self._kept: Cells = np.empty((0, 2), dtype=np.int32)

    def search(self, blocked: Bool, start: Cell, goal: Cell) -> Plan:
        """The cheapest path from start to goal (col, row) on blocked (rows, cols)."""
        if not (is_usable(blocked, start) and is_usable(blocked, goal)):
            return no_plan()
        self._prepare(blocked)
        length, cost, expanded, generated, touched, _ = self._search_on(_NO_MAP, _NO_ROUTE, (0, 0), start, goal, False)
        if length == 0:
            return no_plan(expanded, generated, touched)
        return Plan(True, self._way[-length:].copy(), cost, expanded, generated, touched, True, 0)

    def extend(
        self, blocked: Bool, route: Cells, shift: Cell, start: Cell, goal: Cell, from_end: bool = False
    ) -> Plan | None:
        """What is kept of a route (L, 2), see kept_route, and the cheapest path from there; None when nothing is kept.

        g(r'') = g(waypoint) + g [Planning, eq. 5 corrected].
        """
        if not (is_usable(blocked, start) and is_usable(blocked, goal)):
            return None
        self._prepare(blocked)
        if len(self._kept) < len(route) + REANCHOR_CELLS:
            self._kept = np.empty((2 * len(route) + REANCHOR_CELLS, 2), dtype=np.int32)
        length, cost, expanded, generated, touched, reused = self._search_on(
            blocked, route, shift, start, goal, from_end
        )
        if length > 0:
            return Plan(True, self._way[-length:].copy(), cost, expanded, generated, touched, False, reused)
        return None if length < 0 else no_plan(expanded, generated, touched, from_scratch=False)

    def _search_on(
        self, blocked: Bool, route: Cells, shift: Cell, start: Cell, goal: Cell, from_end: bool
    ) -> tuple[int, int, int, int, int, int]:
        width, is_open = self._padded.shape[1], 2 * self._generation
        found: tuple[int, int, int, int, int, int] = _search_on(
            blocked, route, *shift, start, goal, from_end, self._kept, *self._work, width, self._corner_cutting, is_open
        )
        return found

    def _prepare(self, blocked: Bool) -> None:
        padded_shape = (blocked.shape[0] + 2, blocked.shape[1] + 2)
        if self._padded.shape != padded_shape:
            count = padded_shape[0] * padded_shape[1]
            self._padded = np.ones(padded_shape, dtype=np.uint8)
            self._records = np.zeros((count, 4), dtype=np.int32)
            parent_step = np.empty(count, dtype=np.int8)
            stack, listed = np.empty((2, count), dtype=np.int32)
            keys, heads = np.empty(count, dtype=np.int64), np.empty(RING, dtype=np.int64)
            # The same memory: nothing is sorted any more when the way is written down.
            self._way = keys.view(np.int32).reshape(count, 2)
            steps = STEP_ROW * padded_shape[1] + STEP_COL
            padded = self._padded.reshape(-1)
            self._work = (padded, self._records, parent_step, stack, listed, keys, self._way, heads, steps)
            self._generation = 0
        if self._generation == MAX_GENERATION:
            self._records[:, STAMP] = 0
            self._generation = 0
        self._generation += 1
        self._padded[1:-1, 1:-1] = blocked


@inlined
def _sort(keys, count):  # type: ignore[no-untyped-def]
    """Sorts keys[:count] by insertion: lists are nearly sorted, for cells linked later mostly have a smaller g."""
    for i in range(1, count):
        key = keys[i]
        j = i
        while j > 0 and keys[j - 1] > key:
            keys[j] = keys[j - 1]
            j -= 1
        keys[j] = key


@inlined
def _take_list(heads, slot, records, stack, listed, keys):  # type: ignore[no-untyped-def]
    """Moves a list to the stack, by rising g and among equals as it was linked; returns how many cells it had."""
    count, cell = 0, heads[slot]
    heads[slot] = -1
    while cell >= 0:
        listed[count] = cell
        keys[count] = records[cell, G] << 32 | count
        count += 1
        cell = records[cell, NEXT]
    _sort(keys, count)
    for i in range(count):
        stack[i] = listed[keys[i] & 0xFFFFFFFF]
    return count


@inlined
def _link(heads, slot, cell, records):  # type: ignore[no-untyped-def]
    head = heads[slot]
    records[cell, NEXT] = head
    records[cell, PREVIOUS] = -1
    if head >= 0:
        records[head, PREVIOUS] = cell
    heads[slot] = cell


@inlined
def _unlink(heads, slot, cell, records):  # type: ignore[no-untyped-def]
    after, before = records[cell, NEXT], records[cell, PREVIOUS]
    if before >= 0:
        records[before, NEXT] = after
    else:
        heads[slot] = after
    if after >= 0:
        records[after, PREVIOUS] = before


@inner
def _search(  # type: ignore[no-untyped-def]
    padded, records, parent_step, stack, listed, keys, way, heads, steps, width, start, goal_cell, cutting, is_open,
):  # fmt: skip
    """(cells of the path, its cost, expanded, generated, touched); way's last rows then hold the path.

    start is a flat index in the grid with its border, goal_cell (col, row) counts that too.
    """
    goal_col, goal_row = goal_cell
    goal, is_closed = goal_row * width + goal_col, is_open + 1
    for slot in range(RING):
        heads[slot] = -1
    records[start, G], records[start, STAMP] = 0, is_open
    stack[0] = start
    count, expanded, generated, touched = 1, 0, 1, 0
    # Lists are numbered by f/2.
    bucket = octile(goal_col - start % width, goal_row - start // width) >> 1
    while True:
        farthest = bucket + RING
        while count == 0 and bucket < farthest:
            bucket += 1
            count = _take_list(heads, bucket & RING - 1, records, stack, listed, keys)
        if count == 0:
            return 0, 0, expanded, generated, touched
        count -= 1
        cell = stack[count]
        records[cell, STAMP] = is_closed
        expanded += 1
        if cell == goal:
            length, _ = walk_back(parent_step, way, width, start, goal)
            return length, records[goal, G], expanded, generated, touched
        g, row = records[cell, G], cell // width
        row_to_go, col_to_go = goal_row - row, goal_col - (cell - row * width)
        legal = legal_steps(padded, cell, width, cutting)
        for k in range(8):
            if not (legal >> k) & 1:
                continue
            neighbour = np.uint64(cell + steps[k])
            touched += 1
            stamp = records[neighbour, STAMP]
            if stamp == is_closed:
                continue
            new_g = g + STEP_COST[k]
            h = octile(col_to_go - STEP_COL[k], row_to_go - STEP_ROW[k])
            if stamp != is_open:
                generated += 1
            else:
                old_g = records[neighbour, G]
                if new_g >= old_g:
                    continue
                _unlink(heads, ((old_g + h) >> 1) & RING - 1, neighbour, records)
            records[neighbour, G], records[neighbour, STAMP] = new_g, is_open
            parent_step[neighbour] = k
            new_bucket = (new_g + h) >> 1
            if new_bucket == bucket:
                stack[count] = neighbour
                count += 1
            else:
                _link(heads, new_bucket & RING - 1, neighbour, records)


@kernel
def _search_on(  # type: ignore[no-untyped-def]
    blocked, route, dcol, drow, start, goal, from_end, kept_cells, padded, records, parent_step, stack, listed, keys,
    way, heads, steps, width, cutting, is_open,
):  # fmt: skip
    """What _search gives for the whole path, and how many of its cells are the route's; -1 cells when none is kept.

    An empty route: the path is searched from start. One kernel, because compiling the search twice takes as long again,
    and on a small map a second call from Python longer than the search.
    """
    kept, linking, straights, diagonals = 1, 0, 0, 0
    col, row = start
    if len(route) > 0:
        kept, linking, straights, diagonals = kept_route(
            blocked, route, dcol, drow, start, goal, cutting, (10, 14), kept_cells, from_end
        )
        if kept == 0:
            return -1, 0, 0, 0, 0, 0
        col, row = kept_cells[kept - 1, 0], kept_cells[kept - 1, 1]
    length, cost, expanded, generated, touched = _search(
        padded,
        records,
        parent_step,
        stack,
        listed,
        keys,
        way,
        heads,
        steps,
        width,
        (row + 1) * width + col + 1,
        (goal[0] + 1, goal[1] + 1),
        cutting,
        is_open,
    )
    length = join(way, length, kept_cells, kept)
    return length, cost + 10 * straights + 14 * diagonals, expanded, generated, touched, max(kept - linking, 0)


def make_search(rules: Rules) -> BucketSearch | HeapSearch:
    """The fastest search that supports these rules."""
    if (rules.costs, rules.heuristic, rules.ties) == ("integer", "octile", "larger_g"):
        return BucketSearch(rules.corner_cutting)
    return HeapSearch(rules)
