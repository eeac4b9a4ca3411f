"""The compiled A* under the planners: costs 10/14, octile heuristic, bucket queue, ties to the larger g.

Why it is fast. All costs and heuristics are even, and with the consistent
octile heuristic f grows by at most 28 a step, so OPEN is a ring of 16 lists
(f/2 mod 16) threaded through the cells themselves: no heap, no stale entries.
The list of the smallest f is sorted by g once, when its turn comes. Successors
with the same f have a larger g than everything in it, so they go on top and it
stays sorted: ties go to the larger g exactly. A stamp per cell tells this
search's values from older ones, so nothing is cleared between calls. A border
of blocked cells around the grid spares the bounds checks.

It is one kernel that allocates nothing, with its helpers inlined as they are
typed: apart, each would cost as much to compile again as it does together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.planning.protocol import NO_COST, Bool, Cell, Cells, is_usable

# East, north, west, south, then the diagonals between them: north-east, north-west, south-west, south-east.
# Straight steps come first, because among equal f they lead to the smaller g.
STEP_COL = np.array([1, 0, -1, 0, 1, -1, -1, 1])
STEP_ROW = np.array([0, 1, 0, -1, 1, 1, -1, -1])
STEP_COST = np.array([10, 10, 10, 10, 14, 14, 14, 14])

RING = 16
# Columns of the per-cell record: best cost, stamp (2 * generation, + 1 when closed), list neighbours.
G, STAMP, NEXT, PREVIOUS = 0, 1, 2, 3
MAX_GENERATION = 2**30 - 1


@dataclass(frozen=True, slots=True)
class SearchResult:
    """cells (L, 2) int32 as (col, row) and cost of the best path, and the work it took; see Plan."""

    found: bool
    cells: Cells
    cost: int
    expanded: int
    generated: int
    touched: int


class GridSearch:
    """A* with its work arrays kept from call to call: 34 bytes a cell, of which only touched pages become memory."""

    def __init__(self, corner_cutting: bool = False) -> None:
        self._corner_cutting = corner_cutting
        self._padded: NDArray[np.uint8] = np.ones((0, 0), dtype=np.uint8)
        self._generation = 0

    def search(self, blocked: Bool, start: Cell, goal: Cell) -> SearchResult:
        """The cheapest path from start to goal (col, row) on blocked (rows, cols)."""
        if not (is_usable(blocked, start) and is_usable(blocked, goal)):
            return SearchResult(False, np.empty((0, 2), dtype=np.int32), NO_COST, 0, 0, 0)
        self._prepare(blocked)
        width = self._padded.shape[1]
        first, last = ((row + 1) * width + col + 1 for col, row in (start, goal))
        bucket = octile.py_func(goal[0] - start[0], goal[1] - start[1]) >> 1
        length, expanded, generated, touched = _search(
            *self._work, width, first, (goal[0] + 1, goal[1] + 1), bucket, self._corner_cutting, 2 * self._generation
        )
        cost = int(self._records[last, G]) if length else NO_COST
        cells = self._way[len(self._way) - length :].copy()
        return SearchResult(length > 0, cells, cost, expanded, generated, touched)

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


@njit(cache=True, error_model="numpy", inline="always")
def octile(dcol: int, drow: int) -> int:
    """Cost of the way over free cells: 14 for each diagonal step, 10 for the rest."""
    across, along = abs(dcol), abs(drow)
    # The same as 10 max + 4 min, in fewer branches.
    return 7 * (across + along) + 3 * abs(across - along)


@njit(cache=True, error_model="numpy", inline="always")
def _sort(keys, count):  # type: ignore[no-untyped-def]
    """Sorts keys[:count] by insertion: a list comes nearly sorted, for what is linked later mostly has a smaller g."""
    for i in range(1, count):
        key = keys[i]
        j = i
        while j > 0 and keys[j - 1] > key:
            keys[j] = keys[j - 1]
            j -= 1
        keys[j] = key


@njit(cache=True, error_model="numpy", inline="always")
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


@njit(cache=True, error_model="numpy", inline="always")
def _link(heads, slot, cell, records):  # type: ignore[no-untyped-def]
    head = heads[slot]
    records[cell, NEXT] = head
    records[cell, PREVIOUS] = -1
    if head >= 0:
        records[head, PREVIOUS] = cell
    heads[slot] = cell


@njit(cache=True, error_model="numpy", inline="always")
def _unlink(heads, slot, cell, records):  # type: ignore[no-untyped-def]
    after, before = records[cell, NEXT], records[cell, PREVIOUS]
    if before >= 0:
        records[before, NEXT] = after
    else:
        heads[slot] = after
    if after >= 0:
        records[after, PREVIOUS] = before


@njit(cache=True, error_model="numpy", inline="always")
def _walk_back(parent_step, way, width, start, goal_col, goal_row):  # type: ignore[no-untyped-def]
    """Writes the path to the last rows of way, (col, row) from start to goal without the border: how many they are."""
    col, row, first = goal_col, goal_row, len(way) - 1
    way[first, 0], way[first, 1] = col - 1, row - 1
    while row * width + col != start:
        k = parent_step[row * width + col]
        col, row, first = col - STEP_COL[k], row - STEP_ROW[k], first - 1
        way[first, 0], way[first, 1] = col - 1, row - 1
    return len(way) - first


@njit(cache=True, error_model="numpy", inline="always")
def legal_steps(padded, cell, width, corner_cutting):  # type: ignore[no-untyped-def]
    """The steps allowed from a cell, as bits 0..7 in STEP_COL's order. Unsigned indices spare numba's wrap-around."""
    here, up, one = np.uint64(cell), np.uint64(width), np.uint64(1)
    east, north, west, south = padded[here + one], padded[here + up], padded[here - one], padded[here - up]
    north_east, north_west = padded[here + up + one], padded[here + up - one]
    south_west, south_east = padded[here - up - one], padded[here - up + one]
    if not corner_cutting:
        north_east |= north | east
        north_west |= north | west
        south_west |= south | west
        south_east |= south | east
    straight = east | north << 1 | west << 2 | south << 3
    return 255 - (straight | north_east << 4 | north_west << 5 | south_west << 6 | south_east << 7)


@njit(cache=True, error_model="numpy")
def _search(  # type: ignore[no-untyped-def]
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
    start,
    goal_cell,
    bucket,
    cutting,
    is_open,
):
    """(cells of the path, expanded, generated, touched); way's last rows then hold the path, records its cost.

    start is a flat index in the grid with its border, goal_cell (col, row) counts that too; bucket: f/2 of start.
    """
    goal_col, goal_row = goal_cell
    goal, is_closed = goal_row * width + goal_col, is_open + 1
    for slot in range(RING):
        heads[slot] = -1
    records[start, G], records[start, STAMP] = 0, is_open
    stack[0] = start
    count, expanded, generated, touched = 1, 0, 1, 0
    while True:
        farthest = bucket + RING
        while count == 0 and bucket < farthest:
            bucket += 1
            count = _take_list(heads, bucket & RING - 1, records, stack, listed, keys)
        if count == 0:
            return 0, expanded, generated, touched
        count -= 1
        cell = stack[count]
        records[cell, STAMP] = is_closed
        expanded += 1
        if cell == goal:
            return _walk_back(parent_step, way, width, start, goal_col, goal_row), expanded, generated, touched
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
