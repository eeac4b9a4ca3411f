"""A*: octile heuristic, ties to the larger g, from scratch every time. The honest baseline."""

from __future__ import annotations

from typing import ClassVar

from quadlog.planning.protocol import Bool, Cell, Plan
from quadlog.planning.search_core import GridSearch


class AStar:
    """Optimal on every call, and remembers nothing. See Planner."""

    name: ClassVar[str] = "astar"
    incremental: ClassVar[bool] = False

    def __init__(self, corner_cutting: bool = False) -> None:
        self._search = GridSearch(corner_cutting)

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """The cheapest path; where the window was before does not matter."""
        found = self._search.search(blocked, start, goal)
        return Plan(
            found.found,
            found.cells,
            found.cost,
            found.expanded,
            found.generated,
            found.touched,
            from_scratch=True,
            reused_cells=0,
        )

    def reset(self) -> None:
        """Nothing to forget."""
