from __future__ import annotations

import math

import numpy as np
import pytest

from quadlog.planning.planners import PLANNER_NAMES
from quadlog.planning.registry import PLANNERS, make_planner
from quadlog.planning.rules import HEURISTICS, Rules
from quadlog.planning.settings import PlannerSettings


@pytest.mark.parametrize("name", sorted(PLANNERS))
def test_rules_reach_the_planner(name):
    blocked = np.array([[False, True], [True, False]])
    assert not make_planner(name).plan(blocked, (0, 0), (1, 1)).found
    assert make_planner(name, Rules(corner_cutting=True)).plan(blocked, (0, 0), (1, 1)).cost == 14
    exact = make_planner(name, Rules(costs="exact", ties="smaller_g", corner_cutting=True))
    assert exact.plan(blocked, (0, 0), (1, 1)).cost == np.sqrt(2)
    assert (exact.rules.costs, exact.rules.ties, exact.rules.corner_cutting) == ("exact", "smaller_g", True)


@pytest.mark.parametrize("name", sorted(PLANNERS))
def test_planners_that_are_defined_by_a_heuristic_keep_it(name):
    """The paper's overrates: with it paths of the optimal ones would not be the cheapest."""
    own = {"dijkstra": "zero", "astar_paper": "manhattan"}.get(name, "octile")
    assert make_planner(name).rules.heuristic == own
    is_fixed = not name.startswith(("ia_star", "ea_star", "clearance_astar"))
    for other in HEURISTICS:
        assert make_planner(name, Rules(heuristic=other)).rules.heuristic == (own if is_fixed else other)


def test_names_are_those_of_the_planners():
    """They are listed by themselves: importing the planners would make every command wait for their compiled cores."""
    assert tuple(PLANNERS) == PLANNER_NAMES
    for name in PLANNER_NAMES:
        assert make_planner(name).name == name
        assert PlannerSettings(name=name).name == name


def test_exact_units_tell_paths_of_a_large_map_apart():
    """Two paths are as long only if they have as many steps of each kind, up to 55 000 diagonal ones more or less.

    The nearest miss is where a multiple of the root of 2 is nearest to a whole number.
    """
    straight, diagonal = Rules("exact").step_units
    for diagonals in range(1, 55_000):
        length = diagonals * math.sqrt(2)
        for straights in (math.floor(length), math.ceil(length)):
            assert (straights * straight > diagonals * diagonal) == (straights > length)
        assert abs(diagonals * diagonal - length * straight) < straight * abs(length - round(length))
