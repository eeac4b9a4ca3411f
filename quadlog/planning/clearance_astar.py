"""Clearance A*: what EA* is after, with charges that add up along the way."""

from __future__ import annotations

from typing import ClassVar

from quadlog.planning.danger import danger_levels
from quadlog.planning.ea_star import LEVEL_CHARGE
from quadlog.planning.heap_search import Danger, HeapSearch
from quadlog.planning.protocol import Bool, Cell, Plan
from quadlog.planning.rules import USUAL, Rules


class ClearanceAStar:
    """From scratch on every call, and optimal for steps and charges together. See Planner; cost is that of the steps.

    Each cell entered is charged for its level in the rings around obstacles, a_1 = 14.01 for each
    [Planning, eq. 11], and nothing is given back: a way along an obstacle gets dearer with its length, while a
    narrow passage stays open.
    """

    name: ClassVar[str] = "clearance_astar"
    incremental: ClassVar[bool] = False

    def __init__(self, rules: Rules = USUAL, rings: int = 3) -> None:
        self.rules = rules
        self._rings = rings
        self._search = HeapSearch(rules)

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """The path of least steps and charges."""
        danger = Danger(danger_levels(blocked, self._rings), LEVEL_CHARGE, 0, 0)
        return self._search.search(blocked, start, goal, danger)

    def reset(self) -> None:
        """Nothing to forget."""
