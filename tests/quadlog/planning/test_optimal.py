"""What all planners share whose every path is the cheapest: scipy's Dijkstra knows what it costs."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from quadlog.planning.registry import OPTIMAL, make_planner
from quadlog.planning.rules import COSTS, TIES, Rules

RULES = [
    Rules(costs=costs, ties=ties, corner_cutting=cutting)
    for costs, ties, cutting in product(COSTS, TIES, (False, True))
]
# 16 maps with free cells x 6 planners x 8 rules x 16 goals, of which a twentieth is blocked: more than 10 000.
GOALS = 16
INCREMENTAL = [name for name in OPTIMAL if make_planner(name).incremental]


@st.composite
def queries(draw):
    shape = draw(st.tuples(st.integers(1, 24), st.integers(1, 24)))
    if draw(st.booleans()):
        blocked = draw(arrays(bool, shape, fill=st.just(False)))
    else:
        density = draw(st.sampled_from([0.0, 0.1, 0.25, 0.4, 0.6]))
        blocked = np.random.default_rng(draw(st.integers(0, 2**32 - 1))).random(shape) < density
    cell = st.tuples(st.integers(0, shape[1] - 1), st.integers(0, shape[0] - 1))
    return blocked, draw(cell), draw(cell)


def assert_best(plan, blocked, start, goal, best, rules, assert_legal):
    """best: what the cheapest path costs, inf where there is none."""
    is_asked_of_free_cells = not (blocked[start[1], start[0]] or blocked[goal[1], goal[0]])
    assert plan.found == (is_asked_of_free_cells and np.isfinite(best))
    if plan.found:
        assert_legal(plan, blocked, start, goal, rules)
        assert plan.cost == (best if rules.costs == "integer" else pytest.approx(best, rel=1e-12))
    else:
        assert (plan.cost, plan.cells.shape, plan.reused_cells) == (-1, (0, 2), 0)
        assert is_asked_of_free_cells or plan.expanded == 0


@pytest.mark.parametrize("rules", RULES, ids=str)
def test_every_kind_of_map(grids, cells_of, costs_from, assert_legal, rules):
    """One start on each map, one goal after another: the incremental planners keep what they found."""
    for seed, blocked in enumerate(grids.values()):
        start, *goals = cells_of(blocked, 1 + GOALS, seed)
        best = costs_from(blocked, start, rules)
        for name in OPTIMAL:
            planner = make_planner(name, rules)
            for goal in goals:
                plan = planner.plan(blocked, start, goal)
                assert_best(plan, blocked, start, goal, best[goal[1], goal[0]], rules, assert_legal)


@settings(max_examples=100, deadline=None)
@given(queries(), st.sampled_from(RULES))
def test_any_query(costs_from, assert_legal, query, rules):
    blocked, start, goal = query
    best = costs_from(blocked, start, rules)[goal[1], goal[0]]
    for name in OPTIMAL:
        plan = make_planner(name, rules).plan(blocked, start, goal)
        assert_best(plan, blocked, start, goal, best, rules, assert_legal)
        assert plan.from_scratch


@pytest.mark.parametrize("name", INCREMENTAL)
@pytest.mark.parametrize("rules", RULES, ids=str)
def test_sequences_of_changes(assert_optimal_throughout, name, rules):
    """Obstacles, window, its shape, start and goal change, in 42 sequences each: 1008 in all."""
    kinds = ["map", "window", "shape", "start", "goal"]
    for seed in range(42):
        rng = np.random.default_rng(seed)
        moves = [{kind for kind in kinds if rng.random() < 0.4} for _ in range(6)]
        assert_optimal_throughout(make_planner(name, rules), seed, [0.0, 0.1, 0.25, 0.4][seed % 4], moves)


@pytest.mark.parametrize("name", OPTIMAL)
@pytest.mark.parametrize(("start", "goal"), [((-1, 0), (2, 2)), ((0, 0), (5, 2)), ((0, 0), (2, 4)), ((1, 1), (2, 2))])
def test_start_or_goal_outside_or_blocked_is_a_result(name, start, goal):
    blocked = np.zeros((4, 5), dtype=bool)
    blocked[1, 1] = True
    plan = make_planner(name).plan(blocked, start, goal)
    assert not plan.found
    assert plan.cells.shape == (0, 2)


@pytest.mark.parametrize("name", OPTIMAL)
def test_start_and_goal_in_one_cell(name):
    planner = make_planner(name)
    for _ in range(2):
        plan = planner.plan(np.zeros((1, 1), dtype=bool), (0, 0), (0, 0))
        assert plan.cells.tolist() == [[0, 0]]
        assert plan.cost == 0


@pytest.mark.parametrize("name", [name for name in OPTIMAL if name != "dijkstra"])
def test_a_map_of_nine_million_cells(name):
    """The heuristic leads straight to the goal. Without one, all of them would be expanded."""
    plan = make_planner(name).plan(np.zeros((3000, 3000), dtype=bool), (5, 5), (2994, 2700))
    assert plan.cost == 14 * 2695 + 10 * 294
    assert plan.expanded <= len(plan.cells) == 2990
