"""The compiled search under the incremental planners: it repairs its last answer instead of searching afresh.

A tree of best ways grows from `root` towards `target`. Each cell has g, what
its way cost when it was last expanded, and rhs, what it costs by its
neighbours' g now; OPEN holds the cells where the two differ, and expanding them
in order until the target's way is settled repairs just what matters to it
[LPA*]. When the target moves, km keeps the keys of OPEN lower bounds, so that
they are corrected only as they come up [D* Lite].

Ties. The published keys, (min(g, rhs) + h + km, min(g, rhs)), prefer the smaller
g, which expands all of an open field. With ties to the larger g, among equal f,
cells whose way got dearer (g < rhs) come first, then those with the larger rhs.
It stays optimal: f never falls, dearer cells beget no cell of a smaller f, and
none is left with an f of the target's when the search stops, so that the way
walked back crosses settled cells only; and no cell is expanded more than twice,
once up and once down. A first search does A*'s work.

Costs are int32 where they are 10 and 14, int64 where they are exact: the kernel
is compiled for either when it is first needed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inlined, kernel
from quadlog.planning.grid_search import FIRST_DIAGONAL, STEP_COL, STEP_ROW, around, has_step, is_less, legal_steps
from quadlog.planning.protocol import Bool, Cell, Plan, is_usable, no_plan
from quadlog.planning.rules import Rules

CostType = np.dtype[np.int32] | np.dtype[np.int64]
# Dearer than any way, by the type of the costs: 14 for each cell of a map of 8192 by 8192 is less.
FAR_COSTS: dict[CostType, int] = {np.dtype(np.int32): 2**30, np.dtype(np.int64): 2**60}
# Columns of the per-cell record; PLACE: where in OPEN, from 1, 0 when not there. STAMP: the last call that opened it.
G, RHS, PLACE, STAMP = 0, 1, 2, 3
# Entries of the search's state: values kept between calls, parameters, and four results.
SIZE, CALL, WIDTH, ROOT, TARGET, KM, FAR, STRAIGHT, DIAGONAL, PUBLISHED, EXPANDED, GENERATED, TOUCHED, REUSED = range(
    14
)


class Field(NamedTuple):
    """The work arrays of a grid with its border of blocked cells, n cells in all: 49 bytes a cell, 65 where exact."""

    padded: NDArray[np.uint8]
    records: NDArray[np.int32] | NDArray[np.int64]
    keys: NDArray[np.int64]
    heap: NDArray[np.int32]
    way: NDArray[np.int32]
    steps: NDArray[np.int64]


def empty_field(shape: tuple[int, int], costs: CostType) -> Field:
    """A grid of `shape` (rows, cols), its border counted, where all is blocked and nothing is known."""
    count = shape[0] * shape[1]
    records = np.zeros((count, 4), dtype=costs)
    records[:, : RHS + 1] = FAR_COSTS[costs]
    return Field(
        np.ones(count, dtype=np.uint8),
        records,
        np.empty((count, 2), dtype=np.int64),
        np.empty(count, dtype=np.int32),
        np.empty((count, 2), dtype=np.int32),
        STEP_ROW * shape[1] + STEP_COL,
    )


@inlined
def _step_cost(state, k):  # type: ignore[no-untyped-def]
    return state[STRAIGHT] if k < FIRST_DIAGONAL else state[DIAGONAL]


@kernel
def _legal(padded, cell, width, cutting):  # type: ignore[no-untyped-def]
    """Compiled once for its four callers."""
    return legal_steps(around(padded, cell, width), cutting)


@kernel
def _key(records, state, cell):  # type: ignore[no-untyped-def]
    """(f, tie), which OPEN is sorted by."""
    g, rhs, width, target = records[cell, G], records[cell, RHS], state[WIDTH], state[TARGET]
    row, target_row = cell // width, target // width
    along, across = abs(target_row - row), abs(target - target_row * width - (cell - row * width))
    h = state[STRAIGHT] * abs(across - along) + state[DIAGONAL] * min(across, along)
    least = min(g, rhs)
    if state[PUBLISHED]:
        return least + h + state[KM], least
    return least + h + state[KM], 0 if g < rhs else state[FAR] - rhs


@kernel
def _sift(records, keys, heap, size, cell, place):  # type: ignore[no-untyped-def]
    """Puts a cell into OPEN at the free `place`, or above or below it where its key belongs."""
    f, tie = keys[cell, 0], keys[cell, 1]
    while place > 0:
        above = heap[(place - 1) >> 1]
        if not is_less(f, tie, keys[above, 0], keys[above, 1]):
            break
        heap[place] = above
        records[above, PLACE] = place + 1
        place = (place - 1) >> 1
    while True:
        child = 2 * place + 1
        if child + 1 < size:
            left, right = heap[child], heap[child + 1]
            child += is_less(keys[right, 0], keys[right, 1], keys[left, 0], keys[left, 1])
        if child >= size or not is_less(keys[heap[child], 0], keys[heap[child], 1], f, tie):
            break
        heap[place] = heap[child]
        records[heap[place], PLACE] = place + 1
        place = child
    heap[place] = cell
    records[cell, PLACE] = place + 1


@kernel
def _settle(records, keys, heap, state, cell):  # type: ignore[no-untyped-def]
    """Keeps the cell in OPEN, with its current key, exactly when g and rhs differ."""
    place = records[cell, PLACE] - 1
    if records[cell, G] != records[cell, RHS]:
        if records[cell, STAMP] != state[CALL]:
            records[cell, STAMP] = state[CALL]
            state[GENERATED] += 1
        keys[cell, 0], keys[cell, 1] = _key(records, state, cell)
        if place < 0:
            place = state[SIZE]
            state[SIZE] += 1
        _sift(records, keys, heap, state[SIZE], cell, place)
    elif place >= 0:
        state[SIZE] -= 1
        records[cell, PLACE] = 0
        last = heap[state[SIZE]]
        if last != cell:
            _sift(records, keys, heap, state[SIZE], last, place)


@kernel
def _look_around(padded, records, keys, heap, steps, state, cell, cutting):  # type: ignore[no-untyped-def]
    """Recomputes a cell's rhs from the map and its neighbours."""
    if padded[cell]:
        records[cell, G] = records[cell, RHS] = state[FAR]
    elif cell != state[ROOT]:
        best = state[FAR]
        legal = _legal(padded, cell, state[WIDTH], cutting)
        for k in range(8):
            if has_step(legal, k):
                state[TOUCHED] += 1
                best = min(best, records[cell + steps[k], G] + _step_cost(state, k))
        records[cell, RHS] = best
    _settle(records, keys, heap, state, cell)


@inlined
def _expand(padded, records, keys, heap, steps, state, cell, cutting):  # type: ignore[no-untyped-def]
    """Sets g to rhs where the way got cheaper, to FAR where it got dearer, and updates the neighbours."""
    if records[cell, STAMP] != state[CALL]:
        records[cell, STAMP] = state[CALL]
        state[GENERATED] += 1
    state[EXPANDED] += 1
    old_g, is_dearer = records[cell, G], records[cell, G] < records[cell, RHS]
    g = state[FAR] if is_dearer else records[cell, RHS]
    records[cell, G] = g
    _settle(records, keys, heap, state, cell)
    legal = _legal(padded, cell, state[WIDTH], cutting)
    for k in range(8):
        if not has_step(legal, k):
            continue
        state[TOUCHED] += 1
        neighbour = cell + steps[k]
        if is_dearer:
            if records[neighbour, RHS] == old_g + _step_cost(state, k):
                _look_around(padded, records, keys, heap, steps, state, neighbour, cutting)
        elif records[neighbour, RHS] > g + _step_cost(state, k):
            records[neighbour, RHS] = g + _step_cost(state, k)
            _settle(records, keys, heap, state, neighbour)


@inlined
def _prune(padded, records, keys, heap, steps, state, orphans, cutting):  # type: ignore[no-untyped-def]
    """Forgets every g that does not come from the root over other cells' g.

    Each such way got dearer: found out one by one, every cell would be expanded for it.
    """
    for cell in orphans:
        g, is_supported = records[cell, G], cell == state[ROOT]
        legal = _legal(padded, cell, state[WIDTH], cutting)
        for k in range(8):
            if is_supported:
                break
            if has_step(legal, k):
                state[TOUCHED] += 1
                is_supported = records[cell + steps[k], G] + _step_cost(state, k) == g
        if not is_supported:
            records[cell, G] = state[FAR]
    for cell in orphans:
        # Where the two agree still, the neighbour that g came from is there, and others only got dearer.
        if records[cell, G] != records[cell, RHS]:
            _look_around(padded, records, keys, heap, steps, state, cell, cutting)


@inlined
def _walk(padded, records, way, steps, state, cutting):  # type: ignore[no-untyped-def]
    """Writes the path to way's first rows, (col, row) without the border from target to root: how many they are."""
    cell, width, length = state[TARGET], state[WIDTH], 0
    if records[cell, RHS] >= state[FAR]:
        return 0
    while length < len(way):
        row = cell // width
        way[length, 0], way[length, 1] = cell - row * width - 1, row - 1
        length += 1
        state[REUSED] += records[cell, STAMP] != state[CALL]
        if cell == state[ROOT]:
            return length
        legal, best, nearest = _legal(padded, cell, width, cutting), state[FAR], cell
        for k in range(8):
            if has_step(legal, k) and records[cell + steps[k], G] + _step_cost(state, k) < best:
                nearest = cell + steps[k]
                best = records[nearest, G] + _step_cost(state, k)
        cell = nearest
    # Costs always fall on the way to the root; would they not, this is better than to write beyond the array.
    return 0


@kernel
def repair(  # type: ignore[no-untyped-def]
    padded, records, keys, heap, way, steps, state, opened, orphans, changed, cutting
):
    """The number of cells of the best path from target to root, 0 when there is none; they are way's first rows then.

    opened: cells to put into OPEN that are not there, though g and rhs differ.
    orphans: after a move of the root, all cells with costs, by rising g: see _prune.
    changed: cells that were blocked or freed; their eight neighbours are looked at too.
    """
    for cell in opened:
        _settle(records, keys, heap, state, cell)
    state[CALL] += 1
    state[EXPANDED:] = 0
    _prune(padded, records, keys, heap, steps, state, orphans, cutting)
    for cell in changed:
        for down in (-state[WIDTH], 0, state[WIDTH]):
            for near in range(cell + down - 1, cell + down + 2):
                if 0 <= near < len(padded):
                    _look_around(padded, records, keys, heap, steps, state, near, cutting)
    target = state[TARGET]
    while state[SIZE] > 0:
        cell = heap[0]
        f, tie = _key(records, state, target)
        if records[target, RHS] <= records[target, G] and not is_less(keys[cell, 0], keys[cell, 1], f, tie):
            break
        # Since this key was made the target may have moved: then the cell waits for its turn.
        f, tie = _key(records, state, cell)
        if is_less(keys[cell, 0], keys[cell, 1], f, tie):
            _settle(records, keys, heap, state, cell)
        else:
            _expand(padded, records, keys, heap, steps, state, cell, cutting)
    # A target still in OPEN has not been counted. One that this call did not open was settled before; the root is
    # opened ahead of the call.
    is_of_this_call = records[target, STAMP] == state[CALL] or target == state[ROOT]
    if is_of_this_call and records[target, G] != records[target, RHS] and records[target, RHS] < state[FAR]:
        state[EXPANDED] += 1
    return _walk(padded, records, way, steps, state, cutting)


Array = NDArray[Any]
NO_CELLS: Array = np.empty(0, dtype=np.int64)


class LifelongSearch:
    """Best paths between a root that stays and a target that may move, on maps that change and windows that slide.

    Optimal on every call. A root that left its cell of the lattice means a fresh search; so does the call after one
    whose root or target was blocked or outside.

    Counts: `expanded` are closed cells, the target included where this call settles it, as A* counts its goal; a cell
    counts twice when its way got dearer and was found again. `generated` are distinct cells that entered OPEN or were
    expanded from it in this call; `touched` includes the steps looked at when a cell's cost is worked out again.
    `reused_cells` are those of the path that were not in OPEN in this call.
    """

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self._costs = np.dtype(np.int32) if rules.costs == "integer" else np.dtype(np.int64)
        self._state = np.zeros(REUSED + 1, dtype=np.int64)
        self._state[FAR] = FAR_COSTS[self._costs]
        self._state[[STRAIGHT, DIAGONAL]] = rules.step_units
        self._state[PUBLISHED] = rules.ties == "smaller_g"
        self._shape = (0, 0)
        self._field: Field | None = None
        self._root: Cell = (0, 0)
        self._target: Cell = (0, 0)

    def forget(self) -> None:
        """The next search is a fresh one."""
        self._field = None

    def plan(self, blocked: Bool, root: Cell, target: Cell, shift: Cell) -> Plan:
        """The best path from target to root, both (col, row), on blocked (rows, cols); shift as in Planner."""
        if not (is_usable(blocked, root) and is_usable(blocked, target)):
            self.forget()
            return no_plan()
        padded = np.ones((blocked.shape[0] + 2, blocked.shape[1] + 2), dtype=np.uint8)
        padded[1:-1, 1:-1] = blocked
        width, state = padded.shape[1], self._state
        state[WIDTH] = width
        state[ROOT], state[TARGET] = ((row + 1) * width + col + 1 for col, row in (root, target))
        root_before = root[0] + shift[0], root[1] + shift[1]
        is_fresh = self._field is None or not self._can_grow_from(self._field, root_before)
        field, opened, changed = self._start_afresh(padded) if is_fresh else self._carry_over(padded, target, shift)
        orphans = NO_CELLS
        if not is_fresh and root_before != self._root:
            known = np.flatnonzero(np.minimum(field.records[:, G], field.records[:, RHS]) < state[FAR])
            orphans = known[np.argsort(field.records[known, G], kind="stable")]
        self._field, self._shape, self._root, self._target = field, padded.shape, root, target
        length = repair(*field, state, opened, orphans, changed, self._rules.corner_cutting)
        expanded, generated, touched, reused = (int(count) for count in state[EXPANDED:])
        if length == 0:
            return no_plan(expanded, generated, touched, is_fresh)
        cells = field.way[:length].copy()
        diagonals = int(np.count_nonzero((cells[1:] != cells[:-1]).all(axis=1)))
        cost = self._rules.cost_of(length - 1 - diagonals, diagonals)
        return Plan(True, cells, cost, expanded, generated, touched, is_fresh, 0 if is_fresh else reused)

    def _can_grow_from(self, field: Field, root: Cell) -> bool:
        """Whether the stored costs are valid for a root in this cell of the previous window or outside of it."""
        return root == self._root

    def _start_afresh(self, padded: Array) -> tuple[Field, Array, Array]:
        """A new field with only its root known: (field, cells to open, cells that changed)."""
        field = empty_field(padded.shape, self._costs)
        field.padded[:] = padded.reshape(-1)
        field.records[self._state[ROOT], RHS] = 0
        self._state[[SIZE, KM]] = 0
        return field, self._state[[ROOT]], NO_CELLS

    def _carry_over(self, padded: Array, target: Cell, shift: Cell) -> tuple[Field, Array, Array]:
        """The field of the call before, in this call's window: (field, cells to open, cells that changed)."""
        assert self._field is not None
        field, opened = self._field, NO_CELLS
        before = field.padded.reshape(self._shape)
        if shift == (0, 0) and padded.shape == self._shape:
            across, along = abs(target[0] - self._target[0]), abs(target[1] - self._target[1])
            straight, diagonal = self._rules.step_units
            self._state[KM] += straight * abs(across - along) + diagonal * min(across, along)
        else:
            field, before = _slid(field, self._shape, padded.shape, shift)
            # All keys are recomputed, so km starts from 0.
            self._state[[SIZE, KM]] = 0
            opened = np.flatnonzero(field.records[:, G] != field.records[:, RHS])
        changed = np.flatnonzero(before != padded)
        field.padded[:] = padded.reshape(-1)
        return field, opened, changed


def _slid(field: Field, shape: tuple[int, int], to_shape: tuple[int, ...], shift: Cell) -> tuple[Field, Array]:
    """A field's costs in a window moved by shift, and its old map there, blocked outside it.

    That map keeps, on the border of the new window, what was free there: a change like any other, now that it left.
    """
    slid, before = empty_field((to_shape[0], to_shape[1]), field.records.dtype), np.ones(to_shape, dtype=np.uint8)
    from_rows, to_rows = _overlap(shape[0], to_shape[0], shift[1])
    from_cols, to_cols = _overlap(shape[1], to_shape[1], shift[0])
    before[to_rows, to_cols] = field.padded.reshape(shape)[from_rows, from_cols]
    # Each cell's g and rhs as one thing, to be moved together: several times faster.
    pair = f"V{2 * field.records.itemsize}"
    old, costs = field.records.view(pair)[:, 0].reshape(shape), slid.records.view(pair)[:, 0].reshape(to_shape)
    unknown = costs[0, 0].copy()
    costs[to_rows, to_cols] = old[from_rows, from_cols]
    # A cell of the border has no eight neighbours that could be looked at, so it must never seem to be known.
    for border in (costs[0], costs[-1], costs[:, 0], costs[:, -1]):
        border[...] = unknown
    return slid, before


def _overlap(size: int, to_size: int, shift: int) -> tuple[slice, slice]:
    """Where the indices common to an axis and the same axis moved by shift lie on each of them."""
    first, end = max(shift, 0), min(size, to_size + shift)
    end = max(first, end)
    return slice(first, end), slice(first - shift, end - shift)
