from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.planning.planners.astar import AStar
from quadlog.planning.planners.d_star_lite import DStarLite, LPAStar, MTDStarLite
from quadlog.planning.registry import make_planner
from quadlog.planning.rules import COSTS, TIES, Rules

START, GOAL = (2, 2), (30, 35)
each_planner = pytest.mark.parametrize("make", [DStarLite, LPAStar, MTDStarLite])


@each_planner
def test_same_question_again_expands_nothing(make, forest):
    planner, blocked = make(), forest()
    first, second = planner.plan(blocked, START, GOAL), planner.plan(blocked, START, GOAL)
    assert first.from_scratch
    assert first.expanded > 0
    assert (second.expanded, second.generated, second.touched) == (0, 0, 0)
    assert not second.from_scratch
    assert second.cost == first.cost
    assert second.reused_cells == len(second.cells)


@each_planner
def test_slid_window_keeps_what_it_shares(make):
    """On open ground nothing of the path's costs changes when an empty column enters and another leaves."""
    blocked = np.zeros((30, 30), dtype=bool)
    planner = make()
    before = planner.plan(blocked, (10, 10), (20, 15))
    after = planner.plan(blocked, (9, 9), (19, 14), (1, 1))
    assert not after.from_scratch
    assert after.expanded == 0
    assert after.reused_cells == len(after.cells)
    np.testing.assert_array_equal(after.cells, before.cells - 1)


@pytest.mark.parametrize("name", ["astar", "d_star_lite", "lpa_star", "mt_d_star_lite"])
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.1, 0.25, 0.4]), st.sampled_from(COSTS), st.sampled_from(TIES))
def test_a_first_search_closes_the_cells_that_scipy_knows(costs_from, name, seed, density, costs, ties):
    """With ties to the smaller g all cells with g + h up to the optimal cost: of those with that f, the goal is last.

    With ties to the larger g those with less, as any optimal search must, and the goal, and none with more.
    """
    rng, rules = np.random.default_rng(seed), Rules(costs=costs, ties=ties)
    rows, cols = (int(each) for each in rng.integers(1, 25, 2))
    blocked = rng.random((rows, cols)) < density
    start, goal = ends = [(int(rng.integers(cols)), int(rng.integers(rows))) for _ in range(2)]
    for col, row in ends:
        blocked[row, col] = False
    root, target = (goal, start) if name == "d_star_lite" else (start, goal)
    g, (row, col) = costs_from(blocked, root, rules), np.indices(blocked.shape)
    short, long = np.sort([abs(row - target[1]), abs(col - target[0])], axis=0)
    f, best = g + rules.cost_of(1, 0) * (long - short) + rules.cost_of(0, 1) * short, g[target[1], target[0]]
    plan = make_planner(name, rules).plan(blocked, start, goal)
    assert plan.found == np.isfinite(best)
    most = np.count_nonzero(f <= best * (1 + 1e-9) if plan.found else np.isfinite(g))
    least = np.count_nonzero(f < best * (1 - 1e-9)) + 1 if plan.found and ties == "larger_g" else most
    assert least <= plan.expanded <= most


@pytest.mark.parametrize(
    ("make", "start", "goal"),
    [(DStarLite, START, (30, 34)), (LPAStar, (2, 3), GOAL), (MTDStarLite, (38, 1), GOAL)],
)
def test_fresh_search_when_the_root_moves_and_after_a_reset(make, start, goal, forest):
    """The root of MT-D* Lite may move, but not to where the search before never was."""
    planner, blocked = make(), forest()
    blocked[start[1], start[0]] = False
    planner.plan(blocked, START, GOAL)
    assert planner.plan(blocked, (2, 3) if make is MTDStarLite else START, GOAL).from_scratch is False
    assert planner.plan(blocked, start, goal).from_scratch
    assert not planner.plan(blocked, start, goal).from_scratch
    planner.reset()
    assert planner.plan(blocked, start, goal).from_scratch


@pytest.mark.parametrize(("make", "share"), [(DStarLite, 0.0), (MTDStarLite, 0.5)])
def test_walk_along_the_path_expands_a_fraction_of_what_astar_does(make, share, forest):
    """With D* Lite none. With a moving root some: cells beside the path come cheaper by f from the new start."""
    blocked, planner, expanded, afresh = forest(), make(), 0, 0
    path = [(int(col), int(row)) for col, row in planner.plan(blocked, START, GOAL).cells]
    for start in path[1:]:
        plan, best = planner.plan(blocked, start, GOAL), AStar().plan(blocked, start, GOAL)
        assert not plan.from_scratch or (make is MTDStarLite and start == path[-1])
        assert plan.cost == best.cost
        expanded, afresh = expanded + plan.expanded, afresh + best.expanded
    assert expanded <= share * afresh


@each_planner
@pytest.mark.parametrize("ties", TIES)
def test_small_change_costs_less_than_a_search(make, forest, ties):
    """Near the end that is searched for, so that little hangs on it."""
    planner, blocked = make(Rules(ties=ties)), forest()
    plan = planner.plan(blocked, START, GOAL)
    col, row = plan.cells[2 if make is DStarLite else -3]
    blocked[row, col] = True
    again = planner.plan(blocked, START, GOAL)
    assert not again.from_scratch
    assert 0 < again.expanded < AStar(Rules(ties=ties)).plan(blocked, START, GOAL).expanded
    assert 0 < again.reused_cells < len(again.cells)
