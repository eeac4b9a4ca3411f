from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.planning.planners.astar import AStar
from quadlog.planning.planners.d_star_lite import MAX_START_SHARE, MTDStarLite
from quadlog.planning.rules import COSTS, TIES, Rules
from quadlog.planning.search.lifelong_search import FAR_COSTS, RHS

RULES = st.builds(Rules, costs=st.sampled_from(COSTS), ties=st.sampled_from(TIES), corner_cutting=st.booleans())


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.05, 0.15, 0.25, 0.4]), RULES)
def test_optimal_along_a_walk_that_follows_its_paths(costs_from, assert_legal, seed, density, rules):
    """The window goes with the robot, which walks its path and at times leaves it; goal and obstacles move."""
    rng = np.random.default_rng(seed)
    world = rng.random((90, 90)) < density
    planner, at, goal, last = MTDStarLite(rules), np.array([30, 30]), np.array([38, 36]), np.array([20, 20])
    repaired = 0
    for _ in range(20):
        world ^= rng.random(world.shape) < rng.choice([0.0, 0.002, 0.05])
        origin = np.clip(at - 10, 0, 69)
        goal = np.clip(goal + rng.integers(-2, 3, 2), origin, origin + 20)
        world[at[1], at[0]] = world[goal[1], goal[0]] = False
        blocked = world[origin[1] : origin[1] + 21, origin[0] : origin[0] + 21].copy()
        start, end, shift = (tuple(int(v) for v in xy) for xy in (at - origin, goal - origin, origin - last))
        plan = planner.plan(blocked, start, end, shift)
        best = costs_from(blocked, start, rules)[end[1], end[0]]
        assert plan.found == np.isfinite(best)
        step = rng.integers(-1, 2, 2)
        if plan.found:
            assert plan.cost == pytest.approx(best, rel=1e-12)
            assert_legal(plan, blocked, start, end, rules)
            if rng.random() < 0.8:
                step = plan.cells[min(2, len(plan.cells) - 1)] - start
        repaired += not plan.from_scratch
        last, at = origin, np.clip(at + step, 0, 89)
    assert repaired > 0


def test_walk_along_the_path_expands_a_fraction_of_what_astar_does(forest):
    """Not nothing: beside the path are cells that come cheaper by f from the new start than they did from the old."""
    blocked, planner, expanded, afresh = forest(), MTDStarLite(), 0, 0
    path = [(int(col), int(row)) for col, row in planner.plan(blocked, (2, 2), (30, 35)).cells]
    for start in path[1:]:
        plan, best = planner.plan(blocked, start, (30, 35)), AStar().plan(blocked, start, (30, 35))
        assert not plan.from_scratch or start == path[-1]
        assert plan.cost == best.cost
        expanded, afresh = expanded + plan.expanded, afresh + best.expanded
    assert expanded < 0.5 * afresh


def test_fresh_search_where_the_one_before_never_was_and_after_reset():
    planner, blocked = MTDStarLite(), np.zeros((40, 40), dtype=bool)
    planner.plan(blocked, (20, 20), (30, 20))
    assert not planner.plan(blocked, (21, 20), (30, 20)).from_scratch
    assert planner.plan(blocked, (2, 35), (30, 20)).from_scratch
    planner.reset()
    assert planner.plan(blocked, (2, 35), (30, 20)).from_scratch


def test_a_start_whose_own_way_was_cut_off_is_no_root():
    """A hall: its cost is of a way that is blocked since, which the last search, whose goal was near, did not mind."""
    planner, blocked = MTDStarLite(), np.zeros((1, 30), dtype=bool)
    planner.plan(blocked, (0, 0), (20, 0))
    blocked[0, 18] = True
    assert planner.plan(blocked, (0, 0), (5, 0)).cost == 50
    plan = planner.plan(blocked, (19, 0), (25, 0))
    assert plan.cost == 60
    assert plan.from_scratch


@pytest.mark.parametrize("costs", COSTS)
def test_costs_start_over_before_they_overflow(costs):
    rules = Rules(costs=costs)
    planner, blocked = MTDStarLite(rules), np.zeros((3, 60), dtype=bool)
    planner.plan(blocked, (0, 1), (59, 1))
    records = planner._search._field.records
    records[:, : RHS + 1] += FAR_COSTS[records.dtype] // MAX_START_SHARE - 20 * rules.step_units[0]
    plans = [planner.plan(blocked, (col, 1), (59, 1)) for col in range(1, 30)]
    assert [plan.cost for plan in plans] == [rules.cost_of(59 - col, 0) for col in range(1, 30)]
    assert [plan.from_scratch for plan in plans].count(True) == 1


@pytest.mark.parametrize("costs", COSTS)
def test_a_start_dear_enough_to_start_over_leaves_room_for_any_way(costs):
    """One through half of 8192 x 8192 cells, all of its steps diagonal."""
    far = FAR_COSTS[np.dtype(np.int32 if costs == "integer" else np.int64)]
    assert far // MAX_START_SHARE + Rules(costs=costs).step_units[1] * 8192**2 // 2 < far
