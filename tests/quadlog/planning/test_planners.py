"""What all planners share: a legal path exactly where there is one, as cheap as each promises; scipy knows the cost."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.planning.planners.astar import AStar, AStarPaper
from quadlog.planning.planners.ia_star import MAX_EXCESS
from quadlog.planning.registry import PLANNERS, make_planner
from quadlog.planning.rules import COSTS, HEURISTICS, TIES, Rules

RULES = [
    Rules(costs, heuristic, ties, cutting)
    for costs, heuristic, ties, cutting in product(COSTS, HEURISTICS, TIES, (False, True))
]
MOVES = st.lists(
    st.sets(st.sampled_from(["map", "window", "shape", "start", "goal"]), max_size=3), min_size=2, max_size=10
)
SEEDS, DENSITIES = st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.1, 0.25, 0.4])
each_planner = pytest.mark.parametrize("name", PLANNERS)


OPTIMAL = ("astar", "d_star_lite", "mt_d_star_lite", "lpa_star", "dijkstra")
"""Planners whose every path is the cheapest there is, by usual rules."""


def excess_of(name, rules):
    """How many times the cheapest path's cost a planner's may be."""
    if name in OPTIMAL:
        return 1.0
    return MAX_EXCESS if name == "ia_star_bounded" and rules.heuristic != "manhattan" else np.inf


@each_planner
@pytest.mark.parametrize("rules", [each for each in RULES if each.heuristic == "octile"], ids=str)
def test_every_kind_of_map(grids, cells_of, costs_from, assert_plan, name, rules):
    """One start on each map, one goal after another: the incremental planners keep what they found."""
    for seed, blocked in enumerate(grids.values()):
        start, *goals = cells_of(blocked, 9, seed)
        best = costs_from(blocked, start, rules)
        planner = make_planner(name, rules)
        for goal in goals:
            plan = planner.plan(blocked, start, goal)
            assert_plan(plan, blocked, start, goal, rules, best[goal[1], goal[0]], excess_of(name, rules))


@each_planner
def test_at_the_goal_no_way_is_left(name):
    planner, blocked = make_planner(name), np.zeros((6, 6), np.bool_)
    costs = [planner.plan(blocked, (0, 2), goal).cost for goal in ((5, 1), (4, 4), (0, 2))]
    assert costs[:2] != [0, 0]
    assert costs[2] == 0


@each_planner
@given(SEEDS, DENSITIES, MOVES, st.sampled_from(RULES))
def test_sequences_of_changes(assert_throughout, name, seed, density, moves, rules):
    """Obstacles, window, its shape, start and goal change."""
    planner = make_planner(name, rules)
    assert_throughout(planner, seed, density, moves, excess_of(name, rules))


@pytest.mark.parametrize(("name", "moving"), [("d_star_lite", "start"), ("lpa_star", "goal")])
@given(SEEDS, DENSITIES, st.sampled_from(RULES))
def test_optimal_while_the_root_of_the_search_keeps_its_cell(assert_throughout, name, moving, seed, density, rules):
    """What these two are made for: the search before is used, on call after call."""
    moves = [{"map"}, {"map", moving}, {moving}, {"map"}, set(), {"window"}, {moving, "map"}, {"map", "window"}] * 2
    plans = assert_throughout(make_planner(name, rules), seed, density, moves)
    assert not all(plan.from_scratch for plan in plans[1:])


@each_planner
@pytest.mark.parametrize("rules", [Rules(), Rules(costs="exact", ties="smaller_g")], ids=str)
def test_after_a_reset_it_plans_as_a_fresh_one_on_maps_of_any_size(grids, cells_of, name, rules):
    """What one map left in the work arrays must not be taken for the next one's."""
    planner = make_planner(name, rules)
    for seed, blocked in enumerate([*grids.values(), *grids.values()]):
        start, goal = cells_of(blocked, 2, seed)
        planner.reset()
        ours, fresh = planner.plan(blocked, start, goal), make_planner(name, rules).plan(blocked, start, goal)
        np.testing.assert_array_equal(ours.cells, fresh.cells)
        assert ours._replace(cells=fresh.cells) == fresh


@pytest.mark.parametrize("name", [name for name in OPTIMAL if name != "dijkstra"])
def test_a_map_of_a_million_cells(name):
    """The heuristic leads straight to the goal. Without one, all of them would be expanded."""
    plan = make_planner(name).plan(np.zeros((1000, 1000), dtype=bool), (5, 5), (994, 700))
    assert plan.cost == 14 * 695 + 10 * 294
    assert plan.expanded <= len(plan.cells) == 990


def test_ties_decide_what_open_ground_costs():
    blocked = np.zeros((100, 100), dtype=bool)
    plan, published = (AStar(Rules(ties=ties)).plan(blocked, (3, 5), (90, 60)) for ties in TIES)
    assert plan.expanded == len(plan.cells) == 88
    assert plan.cost == published.cost == 55 * 14 + 32 * 10
    # All cells of the parallelogram that cheapest ways go through.
    assert published.expanded > 33 * 50


def test_counts_of_a_single_step():
    plan = AStar().plan(np.zeros((3, 3), dtype=bool), (1, 1), (2, 1))
    assert (plan.expanded, plan.generated, plan.touched) == (2, 9, 8)


def test_the_papers_heuristic_overrates_diagonal_ways(forest):
    """Fewer cells than A*, and at times a dearer path, here by no more than the heuristic overrates: 20 for 14."""
    dearer, printed, best = [], 0, 0
    for seed in range(40):
        blocked = forest(seed, 0.25)
        ours, cheapest = (each.plan(blocked, (2, 2), (30, 35)) for each in (AStarPaper(), AStar()))
        dearer.append(ours.cost / cheapest.cost)
        printed, best = printed + ours.expanded, best + cheapest.expanded
    assert 1 < max(dearer) <= 20 / 14
    assert printed < best
