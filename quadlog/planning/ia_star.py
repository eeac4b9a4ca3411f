"""IA*: keep the old route up to its best waypoint, and search only from there [Planning, section 2.2]."""

from __future__ import annotations

from typing import ClassVar

from quadlog.planning.protocol import Bool, Cell, Cells, Plan
from quadlog.planning.rules import USUAL, Rules
from quadlog.planning.search import make_search


class IAStar:
    """Incremental and sub-optimal: the route kept is not reconsidered until it is blocked. See Planner.

    Each call translates the old route with the window, drops what has been walked,
    takes the waypoint of least f = g + 10 (|dx| + |dy|) from the end on, and joins it
    to the goal by A*. When any cell of the remaining route is blocked now, or the
    robot has left the route and has no direct way back, A* plans from scratch.
    """

    name: ClassVar[str] = "ia_star"
    incremental: ClassVar[bool] = True

    def __init__(self, rules: Rules = USUAL) -> None:
        self.rules = rules
        self._search = make_search(rules)
        self._route: Cells | None = None

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """The old route up to its waypoint and the best way from there to the goal."""
        route, self._route = self._route, None
        plan = None if route is None else self._search.extend(blocked, route, shift, start, goal)
        if plan is None:
            plan = self._search.search(blocked, start, goal)
        if plan.found:
            self._route = plan.cells
        return plan

    def reset(self) -> None:
        """Forget the route."""
        self._route = None
