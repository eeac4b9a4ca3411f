"""EA* as printed: cells near obstacles get a larger g, so that the way keeps off them [Planning, section 2.3]; and A*
that charges for nearness.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from quadlog.mapping.goal_projection import INFLATIONS
from quadlog.planning.planners.astar import AStar
from quadlog.planning.protocol import Bool, Cell, Plan
from quadlog.planning.rules import USUAL, Rules


def danger_levels(blocked: Bool, rings: int) -> NDArray[np.int8]:
    """Dflag (rows, cols) int8: rings beside an obstacle, one less for each ring away, 0 beyond [Planning, eq. 9].

    A ring is made of the cells at one Chebyshev distance, which eq. 10 means and does not say: its `min` gives the
    cell three columns and one row away the distance 1.
    """
    levels = np.zeros(blocked.shape, dtype=np.int8)
    for ring in range(1, rings + 1):
        levels += INFLATIONS["square"](blocked, ring)
    levels[blocked] = 0
    return levels


# In thousandths of a straight step of 10: a_1 = 14.01, and the 0.02 of eq. 13.
LEVEL_CHARGE, SAME_LEVEL = 1401, 2


class EAStar(AStar):
    """From scratch on every call [Planning, eq. 12 and 13]. See Planner; cost is that of the steps alone.

    Erratum. What is charged on entering a ring is given back on leaving it, so along any path the charges add up to
    the level of its last cell less that of its first: they telescope. The detour is not the answer to a dearer way,
    but comes of the search: cells that are closed stay closed, and the heuristic knows nothing of what is given back,
    so that it overrates. A search that went on with re-opening would return A*'s length. 0.02 for each step within
    a level does not telescope, but below 100 steps it only breaks ties.
    """

    name: ClassVar[str] = "ea_star"
    _heuristic: ClassVar[str] = ""
    _charges: ClassVar[tuple[int, int, int]] = (LEVEL_CHARGE, LEVEL_CHARGE, SAME_LEVEL)

    def __init__(self, rules: Rules = USUAL, rings: int = 3) -> None:
        super().__init__(rules)
        self._rings = rings

    def plan(self, blocked: Bool, start: Cell, goal: Cell, shift: Cell = (0, 0)) -> Plan:
        """The first path that the search finds with these charges."""
        return self._search.search(blocked, start, goal, danger_levels(blocked, self._rings))


class ClearanceAStar(EAStar):
    """From scratch on every call, and optimal for steps and charges together. See Planner; cost is that of the steps.

    Each cell entered is charged for its level in the rings around obstacles, a_1 = 14.01 for each
    [Planning, eq. 11], and nothing is given back: a way along an obstacle gets dearer with its length, while a
    narrow passage stays open.
    """

    name: ClassVar[str] = "clearance_astar"
    _charges: ClassVar[tuple[int, int, int]] = (LEVEL_CHARGE, 0, 0)
