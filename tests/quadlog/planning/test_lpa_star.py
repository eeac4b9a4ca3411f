from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadlog.planning.astar import AStar
from quadlog.planning.lpa_star import LPAStar

MOVES = st.lists(
    st.sets(st.sampled_from(["map", "window", "shape", "start", "goal"]), max_size=3), min_size=2, max_size=10
)


@settings(max_examples=250, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.1, 0.25, 0.4]), MOVES, st.booleans())
def test_optimal_whatever_moves(assert_optimal_throughout, seed, density, moves, corner_cutting):
    assert_optimal_throughout(LPAStar(corner_cutting), seed, density, moves, corner_cutting)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.1, 0.25, 0.4]), st.booleans())
def test_optimal_while_the_start_keeps_its_cell(assert_optimal_throughout, seed, density, corner_cutting):
    """What the planner is made for: the search before is used, on call after call."""
    moves = [{"map"}, {"map", "goal"}, {"goal"}, {"map"}, set(), {"window"}, {"goal", "map"}, {"map", "window"}] * 2
    plans = assert_optimal_throughout(LPAStar(corner_cutting), seed, density, moves, corner_cutting)
    assert not all(plan.from_scratch for plan in plans[1:])


def forest(seed=5, density=0.15):
    blocked = np.random.default_rng(seed).random((40, 40)) < density
    blocked[2, 2] = blocked[35, 30] = blocked[34, 30] = blocked[3, 2] = False
    return blocked


def test_same_question_again_expands_nothing():
    planner, blocked = LPAStar(), forest()
    first, second = planner.plan(blocked, (2, 2), (30, 35)), planner.plan(blocked, (2, 2), (30, 35))
    assert first.from_scratch
    assert first.expanded > 0
    assert (second.expanded, second.generated, second.touched) == (0, 0, 0)
    assert not second.from_scratch
    assert second.cost == first.cost
    assert second.reused_cells == len(second.cells)


def test_unreachable_again_expands_nothing():
    planner, blocked = LPAStar(), forest()
    blocked[20] = True
    first, second = planner.plan(blocked, (2, 2), (30, 35)), planner.plan(blocked, (2, 2), (30, 35))
    assert not first.found
    assert first.expanded > 0
    assert not second.found
    assert second.expanded == 0


def test_slid_window_keeps_what_it_shares():
    """On open ground nothing of the path's costs changes when an empty column enters and another leaves."""
    blocked = np.zeros((30, 30), dtype=bool)
    planner = LPAStar()
    before = planner.plan(blocked, (10, 10), (20, 15))
    after = planner.plan(blocked, (9, 9), (19, 14), (1, 1))
    assert not after.from_scratch
    assert after.expanded == 0
    assert after.reused_cells == len(after.cells)
    np.testing.assert_array_equal(after.cells, before.cells - 1)


def test_first_search_does_no_more_than_astar():
    """Among equal f the larger g goes first; equal f and g are free, which differs by a few cells."""
    for seed in range(20):
        blocked = forest(seed, 0.25)
        plan, best = LPAStar().plan(blocked, (2, 2), (30, 35)), AStar().plan(blocked, (2, 2), (30, 35))
        assert plan.expanded == pytest.approx(best.expanded, rel=0.15, abs=12)
        assert plan.cost == best.cost
    blocked = np.zeros((40, 40), dtype=bool)
    assert LPAStar().plan(blocked, (2, 2), (30, 35)).expanded <= AStar().plan(blocked, (2, 2), (30, 35)).expanded


def test_small_change_costs_less_than_a_search():
    planner, blocked = LPAStar(), forest()
    plan = planner.plan(blocked, (2, 2), (30, 35))
    col, row = plan.cells[-3]
    blocked[row, col] = True
    again = planner.plan(blocked, (2, 2), (30, 35))
    assert not again.from_scratch
    assert 0 < again.expanded < AStar().plan(blocked, (2, 2), (30, 35)).expanded
    assert 0 < again.reused_cells < len(again.cells)


def test_fresh_search_when_the_start_moves_and_after_reset():
    planner, blocked = LPAStar(), forest()
    planner.plan(blocked, (2, 2), (30, 35))
    assert planner.plan(blocked, *((2, 3), (30, 35))).from_scratch
    assert not planner.plan(blocked, *((2, 3), (30, 35))).from_scratch
    planner.reset()
    assert planner.plan(blocked, *((2, 3), (30, 35))).from_scratch


@pytest.mark.parametrize(("start", "goal"), [((-1, 0), (2, 2)), ((0, 0), (5, 2)), ((0, 0), (2, 4)), ((1, 1), (2, 2))])
def test_start_or_goal_outside_or_blocked_is_a_result(start, goal):
    blocked = np.zeros((4, 5), dtype=bool)
    planner = LPAStar()
    planner.plan(blocked, (0, 0), (2, 2))
    blocked[1, 1] = True
    plan = planner.plan(blocked, start, goal)
    assert not plan.found
    assert plan.cells.shape == (0, 2)


def test_one_cell():
    planner = LPAStar()
    for _ in range(2):
        plan = planner.plan(np.zeros((1, 1), dtype=bool), (0, 0), (0, 0))
        assert plan.cells.tolist() == [[0, 0]]
        assert plan.cost == 0
