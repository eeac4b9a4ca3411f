"""The memory of the incremental planners: it carries a search from one window to the next."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.planning import lifelong_core as core
from quadlog.planning.lifelong_core import FAR_COSTS, RHS, Field, G, costs_of, empty_field, repair
from quadlog.planning.protocol import Bool, Cell, Plan, is_usable, no_plan
from quadlog.planning.rules import Rules

Array = NDArray[Any]
NO_CELLS: Array = np.empty(0, dtype=np.int64)


class LifelongSearch:
    """Best paths between a root that stays and a target that may move, on maps that change and windows that slide.

    Optimal on every call. A root that left its cell of the lattice means a fresh search; so does the call after one
    whose root or target was blocked or outside.

    Counts: `expanded` has a cell twice when its way got dearer and was found anew, and lacks the target, which A*
    closes last; `generated` are distinct cells that entered OPEN or were expanded from it in this call; `touched`
    includes the steps looked at when a cell's cost is worked out anew. `reused_cells` are those of the path that
    were not in OPEN in this call.
    """

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self._costs = np.dtype(np.int32) if rules.costs == "integer" else np.dtype(np.int64)
        self._state = np.zeros(core.REUSED + 1, dtype=np.int64)
        self._state[core.FAR] = FAR_COSTS[self._costs]
        self._state[[core.STRAIGHT, core.DIAGONAL]] = rules.step_units
        self._state[core.PUBLISHED] = rules.ties == "smaller_g"
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
        state[core.WIDTH] = width
        state[core.ROOT], state[core.TARGET] = ((row + 1) * width + col + 1 for col, row in (root, target))
        root_before = root[0] + shift[0], root[1] + shift[1]
        is_fresh = self._field is None or not self._can_grow_from(self._field, root_before)
        field, opened, changed = self._start_afresh(padded) if is_fresh else self._carry_over(padded, target, shift)
        orphans = NO_CELLS if is_fresh or root_before == self._root else _by_cost(field, self._state[core.FAR])
        self._field, self._shape, self._root, self._target = field, padded.shape, root, target
        work = (field.padded, field.records, field.keys, field.heap, field.way, field.steps)
        length = repair(*work, state, opened, orphans, changed, self._rules.corner_cutting)
        expanded, generated, touched, reused = (int(count) for count in state[core.EXPANDED :])
        if length == 0:
            return no_plan(expanded, generated, touched, is_fresh)
        cells = field.way[:length].copy()
        reused = 0 if is_fresh else reused
        return Plan(True, cells, self._cost_of(cells), expanded, generated, touched, is_fresh, reused)

    def _can_grow_from(self, field: Field, root: Cell) -> bool:
        """Whether what is known serves a root in this cell of the window before, which may lie outside it."""
        return root == self._root

    def _cost_of(self, cells: Array) -> float:
        diagonals = int(np.count_nonzero((cells[1:] != cells[:-1]).all(axis=1)))
        return self._rules.cost_of(len(cells) - 1 - diagonals, diagonals)

    def _start_afresh(self, padded: Array) -> tuple[Field, Array, Array]:
        """A field that knows nothing but its root: (field, cells to open, cells that changed)."""
        field = empty_field(padded.shape, self._costs)
        field.padded[:] = padded.reshape(-1)
        field.records[self._state[core.ROOT], RHS] = 0
        self._state[[core.SIZE, core.KM]] = 0
        return field, self._state[[core.ROOT]], NO_CELLS

    def _carry_over(self, padded: Array, target: Cell, shift: Cell) -> tuple[Field, Array, Array]:
        """The field of the call before, in this call's window: (field, cells to open, cells that changed)."""
        assert self._field is not None
        field, opened = self._field, NO_CELLS
        before = field.padded.reshape(self._shape)
        if shift == (0, 0) and padded.shape == self._shape:
            across, along = abs(target[0] - self._target[0]), abs(target[1] - self._target[1])
            straight, diagonal = self._rules.step_units
            self._state[core.KM] += straight * abs(across - along) + diagonal * min(across, along)
        else:
            field, before = _slid(field, self._shape, padded.shape, shift)
            # All keys are made anew, so they need no allowance for where the target was.
            self._state[[core.SIZE, core.KM]] = 0
            opened = np.flatnonzero(field.records[:, G] != field.records[:, RHS])
        changed = np.flatnonzero(before != padded)
        field.padded[:] = padded.reshape(-1)
        return field, opened, changed


def _by_cost(field: Field, far: int) -> Array:
    """The cells that have a cost, by rising g."""
    known = np.flatnonzero(np.minimum(field.records[:, G], field.records[:, RHS]) < far)
    cells: Array = known[np.argsort(field.records[known, G], kind="stable")]
    return cells


def _slid(field: Field, shape: tuple[int, int], to_shape: tuple[int, ...], shift: Cell) -> tuple[Field, Array]:
    """What a field knows in a window moved by shift, and its old map there: blocked outside it.

    That map keeps, on the border of the new window, what was free there: a change like any other, now that it left.
    """
    slid, before = empty_field((to_shape[0], to_shape[1]), field.records.dtype), np.ones(to_shape, dtype=np.uint8)
    from_rows, to_rows = _overlap(shape[0], to_shape[0], shift[1])
    from_cols, to_cols = _overlap(shape[1], to_shape[1], shift[0])
    before[to_rows, to_cols] = field.padded.reshape(shape)[from_rows, from_cols]
    costs = costs_of(slid).reshape(to_shape)
    unknown = costs[0, 0].copy()
    costs[to_rows, to_cols] = costs_of(field).reshape(shape)[from_rows, from_cols]
    # A cell of the border has no eight neighbours that could be looked at, so it must never seem to be known.
    for border in (costs[0], costs[-1], costs[:, 0], costs[:, -1]):
        border[...] = unknown
    return slid, before


def _overlap(size: int, to_size: int, shift: int) -> tuple[slice, slice]:
    """Where the indices common to an axis and the same axis moved by shift lie on each of them."""
    first, end = max(shift, 0), min(size, to_size + shift)
    end = max(first, end)
    return slice(first, end), slice(first - shift, end - shift)
