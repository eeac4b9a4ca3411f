"""A*: octile heuristic, ties to the larger g, from scratch every time. The honest baseline."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from quadlog.planning.protocol import Bool, Cell, Plan
from quadlog.planning.rules import USUAL, Rules
from quadlog.planning.search import make_search


class AStar:
    """Optimal on every call, and remembers nothing. See Planner."""

    name: ClassVar[str] = "astar"
    incremental: ClassVar[bool] = False

    def __init__(self, rules: Rules = USUAL) -> None:
        self.rules = replace(rules, heuristic="octile")
        self._search = make_search(self.rules)

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """The cheapest path; where the window was before does not matter."""
        return self._search.search(blocked, start, goal)

    def reset(self) -> None:
        """Nothing to forget."""
