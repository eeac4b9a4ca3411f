"""A search from scratch by given rules: the bucket queue where it can, the heap elsewhere."""

from __future__ import annotations

from typing import Protocol

from quadlog.planning.bucket_search import BucketSearch
from quadlog.planning.heap_search import HeapSearch
from quadlog.planning.protocol import Bool, Cell, Cells, Plan
from quadlog.planning.rules import Rules


class Search(Protocol):
    """Finds a path on one grid after another, and keeps nothing but its memory."""

    def search(self, blocked: Bool, start: Cell, goal: Cell) -> Plan:
        """The path from start to goal (col, row) on blocked (rows, cols); see Planner.plan."""
        ...

    def extend(self, blocked: Bool, route: Cells, shift: Cell, start: Cell, goal: Cell) -> Plan | None:
        """What is kept of a route (L, 2), see kept_route, and a path from there: g(r'') = g(waypoint) + g.

        [Planning, eq. 5 corrected]. None when nothing can be kept.
        """
        ...


def make_search(rules: Rules) -> Search:
    """The fastest search that goes by these rules."""
    if (rules.costs, rules.heuristic, rules.ties) == ("integer", "octile", "larger_g"):
        return BucketSearch(rules.corner_cutting)
    return HeapSearch(rules)
