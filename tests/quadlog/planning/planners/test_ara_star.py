from __future__ import annotations

import numpy as np
import pytest

from quadlog.planning.planners.ara_star import WEIGHTS_TENTHS, ARAStar
from quadlog.planning.rules import COSTS, TIES, Rules


def of_weights(*tenths, rules):
    planner = ARAStar(rules)
    planner._weights = np.array(tenths)
    return planner


@pytest.mark.parametrize("costs", COSTS)
@pytest.mark.parametrize("ties", TIES)
@pytest.mark.parametrize("weight", WEIGHTS_TENTHS)
def test_a_round_costs_no_more_than_its_weight_allows(forest, costs_from, assert_legal, costs, ties, weight):
    """What [ARA*] proves, of any number of rounds that end with this weight."""
    rules, dearer = Rules(costs=costs, ties=ties), 0
    for seed in range(20):
        blocked = forest(seed, 0.3)
        best = costs_from(blocked, (2, 2), rules)[35, 30]
        for rounds in ((weight,), (40, weight)):
            plan = of_weights(*rounds, rules=rules).plan(blocked, (2, 2), (30, 35))
            assert plan.found == np.isfinite(best)
            if plan.found:
                assert_legal(plan, blocked, (2, 2), (30, 35), rules)
                assert best * (1 - 1e-12) <= plan.cost <= best * weight / 10 * (1 + 1e-12)
                dearer += plan.cost > best * (1 + 1e-12)
    assert (dearer > 0) == (weight > 10)


def test_an_unreachable_goal_is_searched_for_once(forest, costs_from):
    blocked = forest()
    blocked[20] = True
    plan = ARAStar().plan(blocked, (2, 2), (30, 35))
    assert not plan.found
    assert plan.expanded == plan.generated == np.isfinite(costs_from(blocked, (2, 2))).sum()
