"""Dijkstra's search: A* without a heuristic, the floor of what knowing the goal is worth."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from quadlog.planning.astar import AStar
from quadlog.planning.rules import USUAL, Rules
from quadlog.planning.search import make_search


class Dijkstra(AStar):
    """Optimal on every call, from scratch, stopping when the goal is closed. See Planner."""

    name: ClassVar[str] = "dijkstra"

    def __init__(self, rules: Rules = USUAL) -> None:
        self.rules = replace(rules, heuristic="zero")
        self._search = make_search(self.rules)
