"""What every planner takes and gives: cells of a window in, a path with its cost and its counts out."""

from __future__ import annotations

from typing import ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from quadlog.planning.rules import USUAL, Rules

Bool = NDArray[np.bool_]
Cells = NDArray[np.int32]
Cell = tuple[int, int]

NO_COST = -1


class Plan(NamedTuple):
    """One answer of a planner; a tuple, because it is made in every replan, some of which take microseconds.

    found: whether the goal can be reached; cells is empty and cost NO_COST when not.
    cells: (L, 2) int32 as (col, row), from start to goal, both included.
    cost: of its steps by the planner's rules, a whole number unless costs are exact.
    expanded: cells closed; generated: distinct cells ever opened; touched: steps examined.
    from_scratch: the search used nothing of the plan before.
    reused_cells: cells of the path taken over from the plan before.
    """

    found: bool
    cells: Cells
    cost: float
    expanded: int
    generated: int
    touched: int
    from_scratch: bool
    reused_cells: int


class Planner(Protocol):
    """Plans on one window after another. Incremental planners remember the plan before.

    rules: those it really goes by; a planner that is defined by one of them keeps it, whatever it is given.
    """

    name: ClassVar[str]
    incremental: ClassVar[bool]
    rules: Rules

    def __init__(self, rules: Rules = USUAL) -> None: ...

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """The path from start to goal, each a (col, row), where blocked (rows, cols) is free.

        shift: how far the window moved since the last call, in cells (dcol, drow):
        what was cell (c, r) then is cell (c - dcol, r - drow) now.
        A start or goal that is blocked or outside gives found = False, never an exception.
        """
        ...

    def reset(self) -> None:
        """Forget the plan before."""
        ...


def is_usable(blocked: Bool, cell: Cell) -> bool:
    """Whether a (col, row) lies in the window and is free."""
    col, row = cell
    return 0 <= row < blocked.shape[0] and 0 <= col < blocked.shape[1] and not blocked[row, col]


def no_plan(expanded: int = 0, generated: int = 0, touched: int = 0, from_scratch: bool = True) -> Plan:
    """The answer when there is no way."""
    nothing = np.empty((0, 2), dtype=np.int32)
    return Plan(False, nothing, NO_COST, expanded, generated, touched, from_scratch, 0)
