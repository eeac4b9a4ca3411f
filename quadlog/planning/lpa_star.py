"""LPA*: searches from the start, and repairs only what a change of the map spoilt."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from quadlog.planning.lifelong import LifelongSearch
from quadlog.planning.protocol import Bool, Cell, Plan
from quadlog.planning.rules import USUAL, Rules


class LPAStar:
    """Optimal and incremental while the start stays in its cell of the map [LPA*]. See Planner.

    A start that moved means a fresh search. A goal that moved does not: it changes the heuristic alone, for which
    the keys allow as D* Lite's do for a start that moved. Ties and counts: see lifelong_core and LifelongSearch.
    """

    name: ClassVar[str] = "lpa_star"
    incremental: ClassVar[bool] = True

    def __init__(self, rules: Rules = USUAL) -> None:
        self.rules = replace(rules, heuristic="octile")
        self._search = LifelongSearch(self.rules)

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """The cheapest path, by what the searches before left of the costs from the start."""
        backwards = self._search.plan(blocked, start, goal, shift)
        return backwards._replace(cells=backwards.cells[::-1].copy())

    def reset(self) -> None:
        """Forget the costs."""
        self._search.forget()
