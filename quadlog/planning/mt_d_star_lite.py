"""Moving-Target D* Lite: robot and goal may both move, and what was searched before still serves."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from quadlog.planning.lifelong import LifelongSearch
from quadlog.planning.lifelong_core import RHS, Field, G
from quadlog.planning.protocol import Bool, Cell, Plan

# The start's own cost grows with every step walked; so it leaves FAR to the ways.
MAX_START_COST = 2**24


class MTDStarLite:
    """Optimal and incremental, with a start and a goal that move [MT-D* Lite]. See Planner.

    It searches from the start. When the robot has moved to a cell whose cost is settled, the tree of ways from there
    on is kept with its costs, all counted from where the search began, and the rest is forgotten at once; a start
    that the search before did not settle means a fresh one. `touched` includes the cells looked at for that.
    Published keys prefer the smaller g among equal f, these the larger: see lifelong_core. Counts: see LifelongSearch.
    """

    name: ClassVar[str] = "mt_d_star_lite"
    incremental: ClassVar[bool] = True

    def __init__(self, corner_cutting: bool = False) -> None:
        self._search = _SearchFromMovingRoot(corner_cutting)

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """The cheapest path, by what the searches before left of the costs from the start."""
        backwards = self._search.plan(blocked, start, goal, shift)
        return replace(backwards, cells=backwards.cells[::-1].copy())

    def reset(self) -> None:
        """Forget the costs."""
        self._search.forget()


class _SearchFromMovingRoot(LifelongSearch):
    def _can_grow_from(self, field: Field, root: Cell) -> bool:
        if root == self._root:
            return True
        (col, row), (rows, cols) = root, self._shape
        if not (0 <= row < rows - 2 and 0 <= col < cols - 2):
            return False
        record = field.records[(row + 1) * cols + col + 1]
        return bool(record[G] == record[RHS] and record[G] < MAX_START_COST)
