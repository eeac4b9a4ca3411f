from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from quadlog.planning.planners.astar import AStar, AStarPaper, Dijkstra
from quadlog.planning.planners.ia_star import MAX_EXCESS, IAStar, IAStarBounded, IAStarEnd
from quadlog.planning.route import REANCHOR_CELLS
from quadlog.planning.rules import HEURISTICS, Rules


@pytest.mark.parametrize("heuristic", HEURISTICS)
def test_first_plan_is_that_of_its_search(heuristic):
    """With the heuristic of [Planning], A* is the printed one."""
    blocked = np.random.default_rng(1).random((40, 40)) < 0.2
    blocked[0, 0] = blocked[39, 39] = False
    alone = {"octile": AStar, "manhattan": AStarPaper, "zero": Dijkstra}[heuristic]
    first, best = (each.plan(blocked, (0, 0), (39, 39)) for each in (IAStar(Rules(heuristic=heuristic)), alone()))
    assert first.from_scratch
    assert (first.cost, first.expanded) == (best.cost, best.expanded)


def test_route_moves_with_the_window():
    """The window slides by one column with the robot and the goal: the same route, and only the goal is searched."""
    blocked = np.zeros((40, 40), dtype=bool)
    planner = IAStar()
    before = planner.plan(blocked, (5, 20), (35, 20))
    after = planner.plan(blocked, (5, 20), (35, 20), (1, 0))
    assert before.from_scratch
    assert not after.from_scratch
    assert after.expanded == 2
    assert after.reused_cells == 30
    np.testing.assert_array_equal(after.cells[:30], before.cells[1:] - [1, 0])


def test_blocked_route_is_planned_from_scratch():
    blocked = np.zeros((20, 20), dtype=bool)
    planner = IAStar()
    planner.plan(blocked, (1, 10), (18, 10))
    blocked[10, 9] = True
    plan = planner.plan(blocked, (2, 10), (18, 10))
    assert plan.from_scratch
    assert plan.found
    assert plan.cost == AStar().plan(blocked, (2, 10), (18, 10)).cost


@pytest.mark.parametrize("away", range(1, REANCHOR_CELLS + 1))
def test_robot_beside_its_route_takes_the_shortest_way_over_it(away):
    """On free ground by diagonal steps, which cost no more than the shortest way; it could get on at several cells.

    Among those as good it is taken to get on at the first, so that all cells of the old route count as reused.
    """
    blocked, planner = np.zeros((30, 60), dtype=bool), IAStar()
    path = planner.plan(blocked, (1, 10), (58, 10)).cells
    plan = planner.plan(blocked, (5, 10 + away), (58, 10))
    assert not plan.from_scratch
    assert plan.cost == 14 * away + 10 * (53 - away) == AStar().plan(blocked, (5, 10 + away), (58, 10)).cost
    np.testing.assert_array_equal(plan.cells[away:], path[4 + away :])
    assert plan.reused_cells == len(path) - 4 - away


def test_robot_that_left_its_path_does_not_walk_backwards():
    """The route leads to the north-east, and the cells of it nearest to the robot lie north-west of it."""
    blocked, planner, at = np.zeros((40, 40), dtype=bool), IAStar(), (10, 5)
    path = planner.plan(blocked, (0, 0), (30, 30)).cells
    away = np.abs(path - at)
    nearest = path[np.argmin(10 * away.max(axis=1) + 4 * away.min(axis=1))]
    assert nearest[0] < at[0]
    plan = planner.plan(blocked, at, (30, 30))
    assert not plan.from_scratch
    assert plan.reused_cells > 0
    assert (np.diff(plan.cells, axis=0) >= 0).all()


def test_sought_from_the_end_the_way_round_an_obstacle_is_kept():
    """A wall across the straight way: by least f all of the detour is searched again, from the end only the goal."""
    blocked = np.zeros((21, 31), dtype=bool)
    blocked[4:17, 15] = True
    plans = {}
    for kind in (IAStar, IAStarEnd):
        planner = kind(Rules(heuristic="manhattan"))
        before = planner.plan(blocked, (2, 10), (28, 10))
        plans[kind] = planner.plan(blocked, tuple(before.cells[1].tolist()), (28, 10))
    least, end = plans[IAStar], plans[IAStarEnd]
    assert end.expanded == 1
    assert least.expanded > 50
    np.testing.assert_array_equal(end.cells, before.cells[1:])


def test_sought_from_the_end_a_path_may_cost_more_than_it_need():
    """The goal comes back towards the robot: what the old route has beyond is dropped, what leads past it is not."""
    blocked, ends, excess = np.zeros((40, 40), dtype=bool), ((2, 2), (30, 20)), 0.0
    planner, best = IAStarEnd(), AStar()
    planner.plan(blocked, *ends)
    for goal in ((30, 10), (25, 4), (20, 4)):
        plan = planner.plan(blocked, (2, 2), goal)
        excess = max(excess, plan.cost / best.plan(blocked, (2, 2), goal).cost - 1)
    assert excess > 0.05


def walks(planner, seed):
    """A robot that walks its paths in a forest to a goal that wanders off: (plans, the cheapest ones)."""
    rng = np.random.default_rng(seed)
    blocked = rng.random((40, 40)) < 0.1
    goal, at = np.array([30, 8]), (2, 8)
    plans, best = [], []
    for _ in range(25):
        goal = np.clip(goal + rng.integers(-1, 3, 2), 0, 39)
        blocked[goal[1], goal[0]] = blocked[at[1], at[0]] = False
        query = blocked, at, (int(goal[0]), int(goal[1]))
        plans.append(planner.plan(*query))
        best.append(AStar().plan(*query))
        if plans[-1].found:
            at = tuple(plans[-1].cells[min(1, len(plans[-1].cells) - 1)].tolist())
    return plans, best


def test_the_bound_is_needed_and_heals():
    """IA* alone goes beyond it on the same walks; where it does not, the two are one."""
    worst = {IAStar: 0.0, IAStarBounded: 0.0}
    for planner, seed in product(worst, range(30)):
        ratios = [plan.cost / best.cost for plan, best in zip(*walks(planner(), seed), strict=True) if best.cost > 0]
        worst[planner] = max(worst[planner], *ratios)
    assert worst[IAStarBounded] <= MAX_EXCESS < worst[IAStar]
