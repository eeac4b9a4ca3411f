"""D* Lite: searches from the goal, so that the robot may move, and repairs only what a change of the map spoilt."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from quadlog.planning.lifelong import LifelongSearch
from quadlog.planning.protocol import Bool, Cell, Plan
from quadlog.planning.rules import USUAL, Rules


class DStarLite:
    """Optimal and incremental while the goal stays in its cell of the map [D* Lite, optimised version]. See Planner.

    A goal that moved means a fresh search. Ties and counts: see lifelong_core and LifelongSearch.
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
