"""IA*: keep the old route up to its best waypoint, and search only from there [Planning, section 2.2]."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from quadlog.planning.protocol import Bool, Cell, Cells, Plan, is_usable, no_plan
from quadlog.planning.route import best_waypoint, direct_way, rest_of_route
from quadlog.planning.search_core import GridSearch

# A robot that follows a smooth path is rarely farther than this from the cells it was planned on.
REANCHOR_CELLS = 5


class IAStar:
    """Incremental and sub-optimal: the route kept is not reconsidered until it is blocked. See Planner.

    Each call translates the old route with the window, drops what has been walked,
    takes the waypoint of least f = g + 10 (|dx| + |dy|) from the end on, and joins it
    to the goal by A*. When any cell of the remaining route is blocked now, or the
    robot has left the route and has no direct way back, A* plans from scratch.
    """

    name: ClassVar[str] = "ia_star"
    incremental: ClassVar[bool] = True

    def __init__(self, corner_cutting: bool = False) -> None:
        self._corner_cutting = corner_cutting
        self._search = GridSearch(corner_cutting)
        self._route: Cells | None = None

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """The old route up to its waypoint and the best way from there to the goal."""
        old_route, self._route = self._route, None
        if not (is_usable(blocked, start) and is_usable(blocked, goal)):
            return no_plan()
        kept, reused = self._remaining(blocked, start, old_route, shift)
        plan = self._from_scratch(blocked, start, goal) if reused == 0 else self._extend(blocked, kept, reused, goal)
        if plan.found:
            self._route = plan.cells
        return plan

    def reset(self) -> None:
        """Forget the route."""
        self._route = None

    def _remaining(self, blocked: Bool, start: Cell, route: Cells | None, shift: Cell) -> tuple[Cells, int]:
        """(path from start over what is left of the old route, cells of it that are old); 0 when nothing holds."""
        nothing = np.empty((0, 2), dtype=np.int32)
        if route is None:
            return nothing, 0
        moved = route - np.array(shift, dtype=np.int32)
        first, end = rest_of_route(blocked, moved, start[0], start[1], self._corner_cutting)
        if end == first:
            return nothing, 0
        rest = moved[first:end]
        anchor_col, anchor_row = int(rest[0, 0]), int(rest[0, 1])
        if (anchor_col, anchor_row) == start:
            return rest, len(rest)
        if max(abs(anchor_col - start[0]), abs(anchor_row - start[1])) > REANCHOR_CELLS:
            return nothing, 0
        for diagonal_first in (True, False):
            link = direct_way(start[0], start[1], anchor_col, anchor_row, diagonal_first)
            if rest_of_route(blocked, link, start[0], start[1], self._corner_cutting) == (0, len(link)):
                return np.concatenate([link[:-1], rest]), len(rest)
        return nothing, 0

    def _extend(self, blocked: Bool, path: Cells, reused: int, goal: Cell) -> Plan:
        """The path up to its best waypoint, and A* from there: g(r'') = g(waypoint) + g [Planning, eq. 5 corrected]."""
        waypoint, waypoint_cost = best_waypoint(path, goal[0], goal[1])
        linking_cells = len(path) - reused
        joint = self._search.search(blocked, (int(path[waypoint, 0]), int(path[waypoint, 1])), goal)
        if not joint.found:
            return no_plan(joint.expanded, joint.generated, joint.touched, from_scratch=False)
        return Plan(
            True,
            np.concatenate([path[:waypoint], joint.cells]),
            int(waypoint_cost) + joint.cost,
            joint.expanded,
            joint.generated,
            joint.touched,
            from_scratch=False,
            reused_cells=max(waypoint + 1 - linking_cells, 0),
        )

    def _from_scratch(self, blocked: Bool, start: Cell, goal: Cell) -> Plan:
        best = self._search.search(blocked, start, goal)
        return Plan(
            best.found,
            best.cells,
            best.cost,
            best.expanded,
            best.generated,
            best.touched,
            from_scratch=True,
            reused_cells=0,
        )
