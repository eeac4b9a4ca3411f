from __future__ import annotations

import numpy as np
import pytest

from quadlog.planning.planners import ara_star
from quadlog.planning.planners.ara_star import WEIGHTS_TENTHS, ARAStar
from quadlog.planning.planners.astar import AStar
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


@pytest.mark.parametrize("ties", TIES)
def test_weight_of_one_alone_is_astar(forest, ties):
    """Which of several cells with equal f and g comes first is free: a few more or less."""
    rules = Rules(ties=ties)
    for seed in range(10):
        blocked = forest(seed, 0.25)
        ours = of_weights(10, rules=rules).plan(blocked, (2, 2), (30, 35))
        best = AStar(rules).plan(blocked, (2, 2), (30, 35))
        assert ours.expanded == pytest.approx(best.expanded, rel=0.15, abs=12)


def test_rounds_go_on_from_what_is_known(forest):
    """All four together expand less than four searches that know nothing would."""
    together = apart = 0
    for seed in range(20):
        blocked = forest(seed, 0.3)
        together += ARAStar().plan(blocked, (2, 2), (30, 35)).expanded
        for weight in WEIGHTS_TENTHS:
            apart += of_weights(weight, rules=Rules()).plan(blocked, (2, 2), (30, 35)).expanded
    assert together < 0.8 * apart


def test_an_unreachable_goal_is_searched_for_once(forest, costs_from):
    blocked = forest()
    blocked[20] = True
    plan = ARAStar().plan(blocked, (2, 2), (30, 35))
    assert not plan.found
    assert plan.expanded == plan.generated == np.isfinite(costs_from(blocked, (2, 2))).sum()


@pytest.mark.parametrize("costs", COSTS)
def test_keys_do_not_overflow_on_the_largest_map(costs):
    """A way through half of 8192 x 8192 cells, and the most inflated heuristic across them."""
    _, diagonal = Rules(costs=costs).step_units
    largest = 10 * diagonal * 8192**2 // 2 + WEIGHTS_TENTHS[0] * diagonal * 8192
    assert largest < 10 * (ara_star.FAR // 16) < 2**63
