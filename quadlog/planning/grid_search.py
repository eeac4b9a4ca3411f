"""The compiled best-first search under the planners that search from scratch: a bucket queue where the rules allow it,
a binary heap for all others.

A byte per cell says whether it is blocked, opened or closed and from where it was reached. Those of eight neighbours
are read at once into the bytes of one word, so that closed cells cost nothing more; a border of blocked cells around
the grid spares the bounds checks.

**Buckets** serve costs 10 and 14, the octile heuristic and ties to the larger g. All costs are even, and f grows by at
most 28 a step, so OPEN is a ring of 16 lists (f/2 mod 16) threaded through the cells themselves: no heap, no stale
entries. The list of the smallest f is sorted by g once, when its turn comes; successors with the same f have a larger
g than everything in it, so they go on top and it stays sorted.

**The heap** holds each cell once and knows where: any heuristic, exact costs, either tie, charges. Cells once closed
stay closed, as the papers print it; with the consistent octile or zero heuristic and no charge for leaving a cell,
nothing better could come to them.

Each search is one kernel with its helpers inlined: compiled apart, they would take as long again.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inlined, kernel
from quadlog.planning.protocol import Bool, Cell, Cells, Plan, is_usable, no_plan
from quadlog.planning.route import ROOM_CELLS, join, kept_route
from quadlog.planning.rules import Rules

# East, north, west, south, then the diagonals between them: north-east, north-west, south-west, south-east.
# Straight steps come first, because among equal f they lead to the smaller g.
STEP_COL = np.array([1, 0, -1, 0, 1, -1, -1, 1])
STEP_ROW = np.array([0, 1, 0, -1, 1, 1, -1, -1])
FIRST_DIAGONAL = 4
# Bits of a cell's state; above them, from bit PARENT on, the step by which it was reached.
BLOCKED, OPENED, CLOSED, PARENT = 1, 2, 4, 3
# A word with each of these bits in all its bytes, and one with all bits of its lower four bytes.
_BLOCKED_8, _STRAIGHT = np.uint64(0x0101010101010101), np.uint64(0xFFFFFFFF)
_BYTE, _OPENED, _TO_CLOSED = np.uint64(8), np.uint64(OPENED), np.uint64(2)
RING = 16
# Columns of the bucket queue's records: best cost, neighbours in the list.
G, NEXT, PREVIOUS = 0, 1, 2


class GridSearch:
    """Best-first search by rules, its work arrays kept from call to call: 21 bytes a cell with buckets, 34 with a heap.

    charges: what cells cost by their level, in thousandths of a straight step: charged for each level of a cell on
    entering it, given back on leaving it, and given back for a step between cells of one level.
    """

    def __init__(self, rules: Rules, charges: tuple[int, int, int] = (0, 0, 0)) -> None:
        self._rules = rules
        usual = (rules.costs, rules.heuristic, rules.ties) == ("integer", "octile", "larger_g")
        self._has_buckets = usual and not any(charges)
        # Tenths a hundred times finer, so that a thousandth of a straight step is a whole number. Exact costs are fine
        # enough: finer, they would overflow on long ways through a large map.
        finer = 100 if rules.costs == "integer" else 1
        units = [finer * each for each in (*rules.step_units, *rules.heuristic_units)]
        dear = [each * units[0] // 1000 for each in charges]
        self._prices = np.array([*units, *dear, -1 if rules.ties == "larger_g" else 1], dtype=np.int64)
        self._state = np.ones((0, 0), dtype=np.uint8)
        self._work: tuple[NDArray[Any], ...] = ()
        self._kept: Cells = np.empty((0, 2), dtype=np.int32)

    def search(self, blocked: Bool, start: Cell, goal: Cell, levels: NDArray[np.int8] | None = None) -> Plan:
        """The cheapest path from start to goal (col, row) on blocked (rows, cols), as far as the heuristic allows.

        levels (rows, cols): see charges; 0 where a cell is as any other.
        """
        if not (is_usable(blocked, start) and is_usable(blocked, goal)):
            return no_plan()
        self._prepare(blocked)
        if levels is not None:
            self._levels[1:-1, 1:-1] = levels
        width, cutting = self._state.shape[1], self._rules.corner_cutting
        ends = (start[1] + 1) * width + start[0] + 1, (goal[1] + 1) * width + goal[0] + 1
        if self._has_buckets:
            return self._plan(_bucket_search(*self._work, width, *ends, cutting), True)
        return self._plan(_heap_search(*self._work, self._prices, width, *ends, cutting), True)

    def extend(self, blocked: Bool, route: Cells, shift: Cell, start: Cell, goal: Cell, from_end: bool) -> Plan | None:
        """What is kept of a route (L, 2), see kept_route, and the cheapest path from there; None when nothing is kept.

        g(r'') = g(waypoint) + g [Planning, eq. 5 corrected].
        """
        if len(self._kept) < len(route) + ROOM_CELLS:
            self._kept = np.empty((2 * len(route) + ROOM_CELLS, 2), dtype=np.int32)
        self._prepare(blocked)
        asked = (*shift, *start, *goal, self._rules.corner_cutting, *self._rules.step_units, from_end)
        work = (blocked, route, asked, self._kept, *self._work)
        found = _bucket_extension(*work) if self._has_buckets else _heap_extension(*work, self._prices)
        return None if found[0] < 0 else self._plan(found[:5], False, found[5])

    def _plan(self, found: tuple[int, ...], fresh: bool, reused: int = 0) -> Plan:
        """Of what a search found: (cells of the path, which are way's last rows, its diagonal steps, three counts)."""
        length, diagonals, expanded, generated, touched = found
        if length == 0:
            return no_plan(expanded, generated, touched, fresh)
        cost = self._rules.cost_of(length - 1 - diagonals, diagonals)
        return Plan(True, self._way[-length:].copy(), cost, expanded, generated, touched, fresh, reused)

    def _prepare(self, blocked: Bool) -> None:
        shape = (blocked.shape[0] + 2, blocked.shape[1] + 2)
        if self._state.shape != shape:
            self._allocate(shape)
        self._inside[...] = blocked

    def _allocate(self, shape: tuple[int, int]) -> None:
        count, self._state = shape[0] * shape[1], np.ones(shape, dtype=np.uint8)
        self._inside = self._state[1:-1, 1:-1].view(np.bool_)  # of one type with a map: copied at a third of the time
        keys = np.empty((count, 1 if self._has_buckets else 2), dtype=np.int64)
        # The same memory: OPEN is no longer needed when the way is written down.
        self._way = keys.reshape(-1).view(np.int32).reshape(-1, 2)[:count]
        if self._has_buckets:
            records, heads = np.empty((count, 3), dtype=np.int32), np.empty(RING, dtype=np.int64)
            self._work = (self._state.reshape(-1), records, heads, keys[:, 0], self._way)
        else:
            self._levels, heap = np.zeros(shape, dtype=np.int8), np.empty((count, 2), dtype=np.int32)
            g = np.empty(count, dtype=np.int64)
            self._work = (self._state.reshape(-1), self._levels.reshape(-1), g, heap, keys, self._way)


@inlined
def around(state, cell, width):  # type: ignore[no-untyped-def]
    """The states of a cell's neighbours, a byte each in STEP_COL's order. Unsigned indices spare the wrap-around."""
    here, up, one = np.uint64(cell), np.uint64(width), np.uint64(1)
    word = np.uint64(state[here + one]) | np.uint64(state[here + up]) << np.uint64(8)
    word |= np.uint64(state[here - one]) << np.uint64(16) | np.uint64(state[here - up]) << np.uint64(24)
    word |= np.uint64(state[here + up + one]) << np.uint64(32) | np.uint64(state[here + up - one]) << np.uint64(40)
    return (
        word | np.uint64(state[here - up - one]) << np.uint64(48) | np.uint64(state[here - up + one]) << np.uint64(56)
    )


@inlined
def legal_steps(near, corner_cutting):  # type: ignore[no-untyped-def]
    """The steps allowed from a cell with these neighbours, see around: a byte each, 0 or 1."""
    shut = near & _BLOCKED_8
    if not corner_cutting:
        # Beside a diagonal are the straight steps of its own number and the next.
        straight = shut & _STRAIGHT
        shut |= (straight | straight >> _BYTE | straight << np.uint64(24) & _STRAIGHT) << np.uint64(32)
    return shut ^ _BLOCKED_8


@inlined
def has_step(steps, k):  # type: ignore[no-untyped-def]
    """Whether a word of steps has the one of a number."""
    return (steps >> np.uint64(8 * k)) & np.uint64(1)


@inlined
def _number_of(steps):  # type: ignore[no-untyped-def]
    """How many steps a word has: the top byte of this product is the sum of all bytes."""
    return np.int64(steps * _BLOCKED_8 >> np.uint64(56))


@inlined
def _walk_back(state, way, width, start, goal):  # type: ignore[no-untyped-def]
    """Writes the path to the last rows of way, (col, row) from start to goal: (its cells, diagonal steps)."""
    cell, first, diagonals = goal, len(way), 0
    while True:
        row, first = cell // width, first - 1
        way[first, 0], way[first, 1] = cell - row * width - 1, row - 1
        if cell == start:
            return len(way) - first, diagonals
        k = state[cell] >> PARENT
        diagonals += k >= FIRST_DIAGONAL
        cell -= STEP_ROW[k] * width + STEP_COL[k]


@inlined
def _octile(dcol, drow):  # type: ignore[no-untyped-def]
    """Cost of the way over free cells, 10 max + 4 min, in fewer branches."""
    across, along = abs(dcol), abs(drow)
    return 7 * (across + along) + 3 * abs(across - along)


@inlined
def _take_list(heads, slot, records, stack):  # type: ignore[no-untyped-def]
    """Moves a list to the empty stack, by rising g, and among equals the one linked first on top: how many cells."""
    count, cell = 0, heads[slot]
    heads[slot] = -1
    while cell >= 0:
        # By insertion: lists are nearly sorted, for cells linked later mostly have a smaller g.
        g, place = np.int64(records[cell, G]), count
        while place > 0 and stack[place - 1] >> 32 > g:
            stack[place] = stack[place - 1]
            place -= 1
        stack[place] = g << 32 | cell
        count += 1
        cell = records[cell, NEXT]
    return count


@kernel
def _bucket_search(state, records, heads, stack, way, width, start, goal, cutting):  # type: ignore[no-untyped-def]
    """See GridSearch._plan. start, goal: flat indices in the grid with its border. stack: g << 32 | cell."""
    goal_row = goal // width
    goal_col = goal - goal_row * width
    for slot in range(RING):
        heads[slot] = -1
    records[start, G], state[start], stack[0] = 0, OPENED, start
    count, expanded, generated, touched = 1, 0, 1, 0
    # Lists are numbered by f/2.
    bucket = _octile(goal_col - start % width, goal_row - start // width) >> 1
    while True:
        farthest = bucket + RING
        while count == 0 and bucket < farthest:
            bucket += 1
            count = _take_list(heads, bucket & RING - 1, records, stack)
        if count == 0:
            return 0, 0, expanded, generated, touched
        count -= 1
        cell, g = stack[count] & 0xFFFFFFFF, stack[count] >> 32
        state[cell] |= CLOSED
        expanded += 1
        if cell == goal:
            length, diagonals = _walk_back(state, way, width, start, goal)
            return length, diagonals, expanded, generated, touched
        row = cell // width
        row_to_go, col_to_go = goal_row - row, goal_col - (cell - row * width)
        near = around(state, cell, width)
        legal = legal_steps(near, cutting)
        touched += _number_of(legal)
        useful = legal & ~(near >> _TO_CLOSED)
        for k in range(8):
            if not has_step(useful, k):
                continue
            neighbour = np.uint64(cell + STEP_ROW[k] * width + STEP_COL[k])
            new_g = g + 10 + (k & FIRST_DIAGONAL)
            h = _octile(col_to_go - STEP_COL[k], row_to_go - STEP_ROW[k])
            if near >> np.uint64(8 * k) & _OPENED:
                old_g = records[neighbour, G]
                if new_g >= old_g:
                    continue
                # Out of its list.
                after, before = records[neighbour, NEXT], records[neighbour, PREVIOUS]
                if before >= 0:
                    records[before, NEXT] = after
                else:
                    heads[((old_g + h) >> 1) & RING - 1] = after
                if after >= 0:
                    records[after, PREVIOUS] = before
            else:
                generated += 1
            records[neighbour, G], state[neighbour] = new_g, OPENED | k << PARENT
            new_bucket = (new_g + h) >> 1
            if new_bucket == bucket:
                stack[count] = new_g << 32 | np.int64(neighbour)
                count += 1
            else:
                slot = new_bucket & RING - 1
                head = heads[slot]
                records[neighbour, NEXT], records[neighbour, PREVIOUS] = head, -1
                if head >= 0:
                    records[head, PREVIOUS] = neighbour
                heads[slot] = neighbour


@kernel
def _bucket_extension(blocked, route, asked, cells, state, records, heads, stack, way):  # type: ignore[no-untyped-def]
    """See GridSearch.extend; one call from Python, for two take longer than the search on a small map.

    Returns what _bucket_search gives, for the whole path, and its cells that are the route's; -1 cells when none is
    kept.
    """
    kept, linking, more, first, last = kept_route(blocked, route, asked, cells)
    if kept == 0:
        return -1, 0, 0, 0, 0, 0
    width, cutting = blocked.shape[1] + 2, asked[6]
    length, diagonals, expanded, generated, touched = _bucket_search(
        state, records, heads, stack, way, width, first, last, cutting
    )
    return join(way, length, cells, kept), diagonals + more, expanded, generated, touched, max(kept - linking, 0)


# Columns of the heap: the cell at a place, and the place of a cell.
CELL, PLACE = 0, 1


@inlined
def is_less(f, tie, than_f, than_tie):  # type: ignore[no-untyped-def]
    """Whether one key comes before another."""
    return f < than_f or (f == than_f and tie < than_tie)


@inlined
def _put(heap, keys, place, cell, f, tie):  # type: ignore[no-untyped-def]
    heap[place, CELL], keys[place, 0], keys[place, 1] = cell, f, tie
    heap[cell, PLACE] = place


@inlined
def _take(heap, keys, size):  # type: ignore[no-untyped-def]
    """The first of `size` cells, taken out; the last one sinks from its place to where its key belongs."""
    first, last, place = heap[0, CELL], size - 1, 0
    cell, f, tie = heap[last, CELL], keys[last, 0], keys[last, 1]
    while True:
        child = 2 * place + 1
        if child + 1 < last and is_less(keys[child + 1, 0], keys[child + 1, 1], keys[child, 0], keys[child, 1]):
            child += 1
        if child >= last or not is_less(keys[child, 0], keys[child, 1], f, tie):
            break
        _put(heap, keys, place, heap[child, CELL], keys[child, 0], keys[child, 1])
        place = child
    _put(heap, keys, place, cell, f, tie)
    return first


@kernel
def _heap_search(state, levels, best_g, heap, keys, way, prices, width, start, goal, cutting):  # type: ignore[no-untyped-def]
    """See GridSearch._plan. start, goal: flat indices in the grid with its border."""
    straight, diagonal, along, across, entering, leaving, same_level, tie = prices
    goal_row = goal // width
    goal_col = goal - goal_row * width
    best_g[start], state[start] = 0, OPENED
    heap[0, CELL], keys[0, 0], keys[0, 1] = start, 0, 0
    size, expanded, generated, touched = 1, 0, 1, 0
    while size > 0:
        cell = _take(heap, keys, size)
        size -= 1
        state[cell] |= CLOSED
        expanded += 1
        if cell == goal:
            length, diagonals = _walk_back(state, way, width, start, goal)
            return length, diagonals, expanded, generated, touched
        row, level = cell // width, levels[cell]
        left_g = best_g[cell] - leaving * level
        row_to_go, col_to_go = goal_row - row, goal_col - (cell - row * width)
        near = around(state, cell, width)
        legal = legal_steps(near, cutting)
        touched += _number_of(legal)
        useful = legal & ~(near >> _TO_CLOSED)
        for k in range(8):
            if not has_step(useful, k):
                continue
            neighbour = cell + STEP_ROW[k] * width + STEP_COL[k]
            g = left_g + (straight if k < FIRST_DIAGONAL else diagonal) + entering * levels[neighbour]
            if levels[neighbour] == level:
                g -= same_level
            place = size
            if near >> np.uint64(8 * k) & _OPENED:
                if g >= best_g[neighbour]:
                    continue
                place = heap[neighbour, PLACE]
            else:
                generated += 1
                size += 1
            best_g[neighbour], state[neighbour] = g, OPENED | k << PARENT
            cols, rows = abs(col_to_go - STEP_COL[k]), abs(row_to_go - STEP_ROW[k])
            f, order = g + along * max(cols, rows) + across * min(cols, rows), tie * g
            while place > 0:
                above = (place - 1) >> 1
                if not is_less(f, order, keys[above, 0], keys[above, 1]):
                    break
                _put(heap, keys, place, heap[above, CELL], keys[above, 0], keys[above, 1])
                place = above
            _put(heap, keys, place, neighbour, f, order)
    return 0, 0, expanded, generated, touched


@kernel
def _heap_extension(blocked, route, asked, cells, state, levels, best_g, heap, keys, way, prices):  # type: ignore[no-untyped-def]
    """As _bucket_extension."""
    kept, linking, more, first, last = kept_route(blocked, route, asked, cells)
    if kept == 0:
        return -1, 0, 0, 0, 0, 0
    width, cutting = blocked.shape[1] + 2, asked[6]
    length, diagonals, expanded, generated, touched = _heap_search(
        state, levels, best_g, heap, keys, way, prices, width, first, last, cutting
    )
    return join(way, length, cells, kept), diagonals + more, expanded, generated, touched, max(kept - linking, 0)
