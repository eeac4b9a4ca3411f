"""Planners that search from scratch every time: A* with octile heuristic and ties to the larger g, the honest
baseline; A* as printed; Dijkstra.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from quadlog.planning.grid_search import GridSearch
from quadlog.planning.protocol import Bool, Cell, Plan
from quadlog.planning.rules import USUAL, Rules


class AStar:
    """Optimal on every call, and remembers nothing. See Planner."""

    name: ClassVar[str] = "astar"
    incremental: ClassVar[bool] = False
    _heuristic: ClassVar[str] = "octile"
    """Empty: that of the rules."""
    _charges: ClassVar[tuple[int, int, int]] = (0, 0, 0)
    """See GridSearch."""

    def __init__(self, rules: Rules = USUAL) -> None:
        self.rules = replace(rules, heuristic=self._heuristic or rules.heuristic)
        self._search = GridSearch(self.rules, self._charges)

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """The cheapest path; where the window was before does not matter."""
        return self._search.search(blocked, start, goal)

    def reset(self) -> None:
        """Nothing to forget."""


class AStarPaper(AStar):
    """From scratch on every call [Planning, section 2.1]. See Planner.

    Its heuristic overrates diagonal ways, so that its paths need not be the cheapest. The paper does not state how
    ties are broken.
    """

    name: ClassVar[str] = "astar_paper"
    _heuristic: ClassVar[str] = "manhattan"


class Dijkstra(AStar):
    """Optimal on every call, from scratch, stopping when the goal is closed. See Planner."""

    name: ClassVar[str] = "dijkstra"
    _heuristic: ClassVar[str] = "zero"
