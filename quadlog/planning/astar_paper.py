"""A* as [Planning] prints it: 10 (|dx| + |dy|) for a heuristic, and what is closed stays closed."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from quadlog.planning.astar import AStar
from quadlog.planning.rules import USUAL, Rules
from quadlog.planning.search import make_search


class AStarPaper(AStar):
    """From scratch on every call [Planning, section 2.1]. See Planner.

    Its heuristic overrates diagonal ways, so that its paths need not be the cheapest. The paper does not state how
    ties are broken.
    """

    name: ClassVar[str] = "astar_paper"

    def __init__(self, rules: Rules = USUAL) -> None:
        self.rules = replace(rules, heuristic="manhattan")
        self._search = make_search(self.rules)
