from __future__ import annotations

import numpy as np
import pytest

from quadlog.config.planners import PLANNER_NAMES
from quadlog.config.schema import PlannerConfig as PlannerSection
from quadlog.errors import UnknownName
from quadlog.planning.registry import OPTIMAL, PLANNERS, make_planner
from quadlog.planning.rules import HEURISTICS, Rules


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
    is_fixed = name in OPTIMAL or name == "astar_paper"
    for other in HEURISTICS:
        assert make_planner(name, Rules(heuristic=other)).rules.heuristic == (own if is_fixed else other)


@pytest.mark.parametrize("name", sorted(PLANNERS))
def test_only_incremental_planners_remember_and_all_forget(name):
    """The first and the third answer know nothing of the one before."""
    blocked, planner = np.zeros((9, 9), dtype=bool), make_planner(name)
    plans = [planner.plan(blocked, (0, 0), (8, 4)) for _ in range(2)]
    planner.reset()
    plans.append(planner.plan(blocked, (0, 0), (8, 4)))
    assert [plan.from_scratch for plan in plans] == [True, not planner.incremental, True]
    assert (plans[1].reused_cells > 0) == planner.incremental


def test_names_are_those_of_the_planners():
    """They are listed by themselves: importing the planners would make every command wait for their compiled cores."""
    assert tuple(PLANNERS) == PLANNER_NAMES
    for name in PLANNER_NAMES:
        assert make_planner(name).name == name
        assert PlannerSection(name=name).name == name


def test_unknown_name_lists_the_choices():
    with pytest.raises(UnknownName) as raised:
        make_planner("a*")
    assert str(raised.value) == (
        "unknown planner 'a*'; choose one of: ara_star, astar, astar_paper, clearance_astar, d_star_lite, dijkstra, "
        "ea_star, ia_star, ia_star_bounded, ia_star_end, lpa_star, mt_d_star_lite"
    )
