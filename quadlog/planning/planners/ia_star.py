"""IA*: keep the old route up to a waypoint, and search only from there [Planning, section 2.2]: by both readings of
"searched out from the end vertex", and with a bounded cost.
"""

from __future__ import annotations

from typing import ClassVar

from quadlog.planning.grid_search import GridSearch
from quadlog.planning.protocol import Bool, Cell, Cells, Plan
from quadlog.planning.rules import USUAL, Rules


class IAStar:
    """Incremental and sub-optimal: the route kept is not reconsidered until it is blocked. See Planner.

    Each call translates the old route with the window, drops what has been walked,
    takes the waypoint of least f = g + 10 (|dx| + |dy|) from the end on, and joins it
    to the goal by A*. When any cell of the remaining route is blocked now, or the
    robot has left the route and has no direct way back, A* plans from scratch.
    """

    name: ClassVar[str] = "ia_star"
    incremental: ClassVar[bool] = True
    _from_end: ClassVar[bool] = False

    def __init__(self, rules: Rules = USUAL) -> None:
        self.rules = rules
        self._search = GridSearch(rules)
        self._route: Cells | None = None

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """The old route up to its waypoint and the best way from there to the goal."""
        route, self._route = self._route, None
        plan = None
        if route is not None and start != goal:  # at the goal no old route is worth a step
            plan = self._search.extend(blocked, route, shift, start, goal, self._from_end)
        if plan is None:
            plan = self._search.search(blocked, start, goal)
        if plan.found:
            self._route = plan.cells
        return plan

    def reset(self) -> None:
        """Forget the route."""
        self._route = None


class IAStarEnd(IAStar):
    """IA* whose waypoint is sought from the end of the old route, walking back while f falls. See Planner.

    The paper's words fit it as well as the least f of the whole route. It keeps more: where a route leads round an
    obstacle, f has its least value before the detour, but falls towards the end too. So it searches less, and its
    paths are longer.
    """

    name: ClassVar[str] = "ia_star_end"
    _from_end: ClassVar[bool] = True


# Chosen on walks that no table reports: at 1.1 half of the cells that IA* saves are lost, above 1.2 few come back.
MAX_EXCESS = 1.2


class IAStarBounded(IAStar):
    """IA* whose paths never cost more than MAX_EXCESS times the cheapest one's. See Planner.

    The cheapest path is not known without a search, but it costs no less than the way over free cells would. So a
    path dearer than MAX_EXCESS times that is thrown away, and A* plans from scratch; both searches are counted.
    Where obstacles make every way longer than that, each replan is one from scratch.
    With the heuristic of [Planning], which overrates, the bound holds for paths kept, not for those found afresh.
    """

    name: ClassVar[str] = "ia_star_bounded"

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """IA*'s path when it is short enough, else the one found from scratch."""
        kept = super().plan(blocked, start, goal, shift)
        if not kept.found or kept.from_scratch or kept.cost <= MAX_EXCESS * self._least_cost(start, goal):
            return kept
        fresh = self._search.search(blocked, start, goal)
        self._route = fresh.cells
        return fresh._replace(
            expanded=kept.expanded + fresh.expanded,
            generated=kept.generated + fresh.generated,
            touched=kept.touched + fresh.touched,
        )

    def _least_cost(self, start: Cell, goal: Cell) -> float:
        """What the way would cost over free cells."""
        across, along = abs(goal[0] - start[0]), abs(goal[1] - start[1])
        return self.rules.cost_of(abs(across - along), min(across, along))
