"""What the other planners share: a legal path exactly where there is one, and none cheaper than the cheapest."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadlog.planning.registry import OPTIMAL, PLANNERS, make_planner
from quadlog.planning.rules import COSTS, HEURISTICS, TIES, Rules

OTHERS = [name for name in PLANNERS if name not in OPTIMAL]
RULES = [
    Rules(costs, heuristic, ties, cutting)
    for costs, heuristic, ties, cutting in product(COSTS, HEURISTICS, TIES, (False, True))
]
MOVES = st.lists(
    st.sets(st.sampled_from(["map", "window", "shape", "start", "goal"]), max_size=3), min_size=2, max_size=10
)


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("rules", RULES[::5], ids=str)
def test_every_kind_of_map(grids, cells_of, costs_from, assert_legal, name, rules):
    for seed, blocked in enumerate(grids.values()):
        start, *goals = cells_of(blocked, 7, seed)
        best = costs_from(blocked, start, rules)
        planner = make_planner(name, rules)
        for goal in goals:
            plan = planner.plan(blocked, start, goal)
            can = not (blocked[start[1], start[0]] or blocked[goal[1], goal[0]])
            assert plan.found == (can and np.isfinite(best[goal[1], goal[0]]))
            if plan.found:
                assert_legal(plan, blocked, start, goal, rules)
                assert plan.cost >= best[goal[1], goal[0]] * (1 - 1e-12)


@pytest.mark.parametrize("name", OTHERS)
@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.1, 0.25, 0.4]), MOVES, st.sampled_from(RULES))
def test_sequences_of_changes(assert_optimal_throughout, name, seed, density, moves, rules):
    assert_optimal_throughout(make_planner(name, rules), seed, density, moves, excess=np.inf)


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize(("start", "goal"), [((-1, 0), (2, 2)), ((0, 0), (5, 2)), ((0, 0), (2, 4)), ((1, 1), (2, 2))])
def test_start_or_goal_outside_or_blocked_is_a_result(name, start, goal):
    blocked = np.zeros((4, 5), dtype=bool)
    blocked[1, 1] = True
    plan = make_planner(name).plan(blocked, start, goal)
    assert not plan.found
    assert plan.cells.shape == (0, 2)


@pytest.mark.parametrize("name", OTHERS)
def test_start_and_goal_in_one_cell(name):
    planner = make_planner(name)
    for _ in range(2):
        plan = planner.plan(np.zeros((1, 1), dtype=bool), (0, 0), (0, 0))
        assert plan.cells.tolist() == [[0, 0]]
        assert plan.cost == 0
