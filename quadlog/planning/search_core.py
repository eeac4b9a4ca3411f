"""The compiled A* under the planners: costs 10/14, octile heuristic, bucket queue, ties to the larger g.

Why it is fast. All costs and heuristics are even, and with the consistent
octile heuristic f grows by at most 28 a step, so OPEN is a ring of 16 lists
(f/2 mod 16) threaded through the cells themselves: no heap, no stale entries.
The list of the smallest f is sorted by g once, when its turn comes. Successors
with the same f have a larger g than everything in it, so they go on top and it
stays sorted: ties go to the larger g exactly. A stamp per cell tells this
search's values from older ones, so nothing is cleared between calls. A border
of blocked cells around the grid spares the bounds checks.
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
SMALL_SORT = 24
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
    """A* with its work arrays kept from call to call: 26 bytes a cell, of which only touched pages become memory."""

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
        expanded, generated, touched, found = _search(
            self._padded.reshape(-1),
            width,
            first,
            last,
            self._corner_cutting,
            self._generation,
            self._records,
            self._parent_step,
            self._stack,
            self._scratch,
        )
        if not found:
            return SearchResult(False, np.empty((0, 2), dtype=np.int32), NO_COST, expanded, generated, touched)
        cells = _walk_back(self._parent_step, width, first, last)
        return SearchResult(True, cells, int(self._records[last, G]), expanded, generated, touched)

    def _prepare(self, blocked: Bool) -> None:
        padded_shape = (blocked.shape[0] + 2, blocked.shape[1] + 2)
        if self._padded.shape != padded_shape:
            count = padded_shape[0] * padded_shape[1]
            self._padded = np.ones(padded_shape, dtype=np.uint8)
            self._records = np.zeros((count, 4), dtype=np.int32)
            self._parent_step = np.empty(count, dtype=np.int8)
            self._stack = np.empty(count, dtype=np.int32)
            self._scratch = np.empty(count, dtype=np.int32)
            self._generation = 0
        if self._generation == MAX_GENERATION:
            self._records[:, STAMP] = 0
            self._generation = 0
        self._generation += 1
        self._padded[1:-1, 1:-1] = blocked


@njit(cache=True)
def octile(dcol: int, drow: int) -> int:
    """Cost of the way over free cells: 14 for each diagonal step, 10 for the rest."""
    across, along = abs(dcol), abs(drow)
    return 10 * max(across, along) + 4 * min(across, along)


@njit(cache=True)
def _sort_by_cost(cells, count, records, scratch):  # type: ignore[no-untyped-def]
    """Sorts cells[:count] by rising g: by insertion when few, else byte by byte (radix), g being even."""
    if count <= SMALL_SORT:
        for i in range(1, count):
            cell, g = cells[i], records[cells[i], G]
            j = i
            while j > 0 and records[cells[j - 1], G] > g:
                cells[j] = cells[j - 1]
                j -= 1
            cells[j] = cell
        return
    low = high = records[cells[0], G]
    for i in range(1, count):
        g = records[cells[i], G]
        low, high = min(low, g), max(high, g)
    shift = 1
    places = np.empty(257, dtype=np.int64)
    while (high - low) >> shift:
        places[:] = 0
        for i in range(count):
            places[(((records[cells[i], G] - low) >> shift) & 255) + 1] += 1
        for byte in range(256):
            places[byte + 1] += places[byte]
        for i in range(count):
            byte = ((records[cells[i], G] - low) >> shift) & 255
            scratch[places[byte]] = cells[i]
            places[byte] += 1
        cells[:count] = scratch[:count]
        shift += 8


@njit(cache=True)
def _next_bucket(heads, bucket, records, stack, scratch):  # type: ignore[no-untyped-def]
    """Moves the next non-empty list, sorted, to the stack: (its f/2, its count), count 0 when OPEN is empty."""
    for ahead in range(1, RING):
        head = heads[(bucket + ahead) % RING]
        if head >= 0:
            count = 0
            while head >= 0:
                stack[count] = head
                count += 1
                head = records[head, NEXT]
            heads[(bucket + ahead) % RING] = -1
            _sort_by_cost(stack, count, records, scratch)
            return bucket + ahead, count
    return bucket, 0


@njit(cache=True)
def _link(heads, slot, cell, records):  # type: ignore[no-untyped-def]
    head = heads[slot]
    records[cell, NEXT] = head
    records[cell, PREVIOUS] = -1
    if head >= 0:
        records[head, PREVIOUS] = cell
    heads[slot] = cell


@njit(cache=True)
def _unlink(heads, slot, cell, records):  # type: ignore[no-untyped-def]
    after, before = records[cell, NEXT], records[cell, PREVIOUS]
    if before >= 0:
        records[before, NEXT] = after
    else:
        heads[slot] = after
    if after >= 0:
        records[after, PREVIOUS] = before


@njit(cache=True)
def _legal_steps(padded, cell, width, corner_cutting):  # type: ignore[no-untyped-def]
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


@njit(cache=True)
def _search(  # type: ignore[no-untyped-def]
    padded, width, start, goal, corner_cutting, generation, records, parent_step, stack, scratch
):
    """(expanded, generated, touched, found); parent_step and records then hold the path and its cost."""
    steps = STEP_ROW * width + STEP_COL
    goal_row, goal_col = goal // width, goal % width
    is_open, is_closed = 2 * generation, 2 * generation + 1
    heads = np.full(RING, -1, dtype=np.int64)
    bucket = octile(goal_col - start % width, goal_row - start // width) >> 1
    records[start, G], records[start, STAMP] = 0, is_open
    stack[0] = start
    count, expanded, generated, touched = 1, 0, 1, 0
    while True:
        if count == 0:
            bucket, count = _next_bucket(heads, bucket, records, stack, scratch)
            if count == 0:
                return expanded, generated, touched, False
        count -= 1
        cell = stack[count]
        records[cell, STAMP] = is_closed
        expanded += 1
        if cell == goal:
            return expanded, generated, touched, True
        g, row = records[cell, G], cell // width
        row_to_go, col_to_go = goal_row - row, goal_col - (cell - row * width)
        legal = _legal_steps(padded, cell, width, corner_cutting)
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
                _unlink(heads, ((old_g + h) >> 1) % RING, neighbour, records)
            records[neighbour, G], records[neighbour, STAMP] = new_g, is_open
            parent_step[neighbour] = k
            new_bucket = (new_g + h) >> 1
            if new_bucket == bucket:
                stack[count] = neighbour
                count += 1
            else:
                _link(heads, new_bucket % RING, neighbour, records)


@njit(cache=True)
def _walk_back(parent_step, width, start, goal):  # type: ignore[no-untyped-def]
    """The path as (L, 2) int32 (col, row) from start to goal, without the border."""
    length, cell = 1, goal
    while cell != start:
        k = parent_step[cell]
        cell -= STEP_ROW[k] * width + STEP_COL[k]
        length += 1
    cells = np.empty((length, 2), dtype=np.int32)
    cell = goal
    for i in range(length - 1, -1, -1):
        cells[i, 0], cells[i, 1] = cell % width - 1, cell // width - 1
        if i > 0:
            k = parent_step[cell]
            cell -= STEP_ROW[k] * width + STEP_COL[k]
    return cells
