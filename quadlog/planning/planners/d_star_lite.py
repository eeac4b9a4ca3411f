"""Planners that repair their last search where the map has changed: D* Lite from the goal, its moving-target form,
and LPA*.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from quadlog.planning.lifelong import FAR, RHS, Field, G, LifelongSearch
from quadlog.planning.protocol import Bool, Cell, Plan
from quadlog.planning.rules import USUAL, Rules


class DStarLite:
    """Optimal and incremental while the goal stays in its cell of the map [D* Lite, optimised version]. See Planner.

    A goal that moved means a fresh search. Ties and counts: see quadlog.planning.lifelong.
    """

    name: ClassVar[str] = "d_star_lite"
    incremental: ClassVar[bool] = True

    def __init__(self, rules: Rules = USUAL) -> None:
        self.rules = replace(rules, heuristic="octile")
        self._search = LifelongSearch(self.rules)

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """The cheapest path, by what the searches before left of the costs to the goal."""
        return self._search.plan(blocked, goal, start, shift)

    def reset(self) -> None:
        """Forget the costs."""
        self._search.forget()


class LPAStar(DStarLite):
    """Optimal and incremental while the start stays in its cell of the map [LPA*]. See Planner.

    A start that moved means a fresh search. A goal that moved does not: it changes the heuristic alone, for which
    the keys allow as D* Lite's do for a start that moved. Ties and counts: see quadlog.planning.lifelong.
    """

    name: ClassVar[str] = "lpa_star"

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """The cheapest path, by what the searches before left of the costs from the start."""
        backwards = self._search.plan(blocked, start, goal, shift)
        return backwards._replace(cells=backwards.cells[::-1].copy())


# The start's own cost grows with every step walked; this share of FAR leaves the rest to the ways.
MAX_START_SHARE = 64


class MTDStarLite(LPAStar):
    """Optimal and incremental, with a start and a goal that move [MT-D* Lite]. See Planner.

    It searches from the start. When the robot has moved to a cell whose cost is settled, the tree of ways from there
    on is kept with its costs, all counted from where the search began, and the rest is forgotten at once; a start
    that the search before did not settle means a fresh one. `touched` includes the cells looked at for that.
    Ties "smaller_g" are the published keys; those to the larger g are not: see lifelong. Counts: see
    LifelongSearch.
    """

    name: ClassVar[str] = "mt_d_star_lite"

    def __init__(self, rules: Rules = USUAL) -> None:
        super().__init__(rules)
        self._search = _SearchFromMovingRoot(self.rules)


class _SearchFromMovingRoot(LifelongSearch):
    def _can_grow_from(self, field: Field, root: Cell) -> bool:
        if root == self._root:
            return True
        (col, row), (rows, cols) = root, self._shape
        if not (0 <= row < rows - 2 and 0 <= col < cols - 2):
            return False
        record = field.records[(row + 1) * cols + col + 1]
        return bool(record[G] == record[RHS] and record[G] < self._state[FAR] // MAX_START_SHARE)
