from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from quadlog.planning.astar import AStar
from quadlog.planning.ia_star import REANCHOR_CELLS, IAStar
from quadlog.planning.route import best_waypoint, direct_way, rest_of_route


def random_free_cell(rng, blocked):
    rows, cols = np.nonzero(~blocked)
    i = rng.integers(len(rows))
    return int(cols[i]), int(rows[i])


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), density=st.sampled_from([0.05, 0.2, 0.35]), corner_cutting=st.booleans())
def test_always_legal_over_random_walks_and_changes(costs_from, assert_legal, seed, density, corner_cutting):
    """Windows slide and change shape, obstacles come and go, robot and goal move at will or along the path."""
    rng = np.random.default_rng(seed)
    world = rng.random((120, 120)) < density
    planner = IAStar(corner_cutting)
    origin, plan, last_origin, start = np.array([40, 40]), None, None, None
    for _ in range(12):
        shape = (int(rng.integers(15, 30)), int(rng.integers(15, 30)))
        world ^= rng.random(world.shape) < rng.choice([0.0, 0.005, 0.05])
        blocked = world[origin[1] : origin[1] + shape[0], origin[0] : origin[0] + shape[1]].copy()
        if blocked.all():
            continue
        start = random_free_cell(rng, blocked)
        if plan is not None and plan.found and rng.random() < 0.8:
            walked = plan.cells[min(int(rng.integers(1, 4)), len(plan.cells) - 1)] + last_origin - origin
            walked = walked + rng.integers(-1, 2, 2) * int(rng.random() < 0.3)
            col, row = int(walked[0]), int(walked[1])
            if 0 <= row < shape[0] and 0 <= col < shape[1] and not blocked[row, col]:
                start = col, row
        goal = random_free_cell(rng, blocked)
        shift = (0, 0) if last_origin is None else tuple(int(v) for v in origin - last_origin)
        plan = planner.plan(blocked, start, goal, shift)
        last_origin = origin.copy()
        best = costs_from(blocked, start, corner_cutting)[goal[1], goal[0]]
        assert plan.found == np.isfinite(best)
        if plan.found:
            assert_legal(plan, blocked, start, goal, corner_cutting)
            assert plan.cost >= best
            if plan.from_scratch:
                assert plan.cost == best
                assert plan.reused_cells == 0
        origin = np.clip(origin + rng.integers(-3, 4, 2), 0, 85)


def test_first_plan_is_that_of_a_star():
    blocked = np.random.default_rng(1).random((40, 40)) < 0.2
    blocked[0, 0] = blocked[39, 39] = False
    first, best = IAStar().plan(blocked, (0, 0), (39, 39)), AStar().plan(blocked, (0, 0), (39, 39))
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


def test_standing_still_expands_the_goal_alone():
    blocked = np.random.default_rng(5).random((40, 40)) < 0.15
    blocked[2, 2] = blocked[35, 30] = False
    planner = IAStar()
    first = planner.plan(blocked, (2, 2), (30, 35))
    second = planner.plan(blocked, (2, 2), (30, 35))
    assert first.found
    assert second.cost == first.cost
    # A detour can make a cell before the end look better, never one farther than the end.
    assert second.expanded <= first.expanded
    assert not second.from_scratch


def test_blocked_route_is_planned_from_scratch():
    blocked = np.zeros((20, 20), dtype=bool)
    planner = IAStar()
    planner.plan(blocked, (1, 10), (18, 10))
    blocked[10, 9] = True
    plan = planner.plan(blocked, (2, 10), (18, 10))
    assert plan.from_scratch
    assert plan.found
    assert plan.cost == AStar().plan(blocked, (2, 10), (18, 10)).cost


def test_robot_beside_its_route_returns_to_it():
    blocked = np.zeros((30, 60), dtype=bool)
    planner = IAStar()
    planner.plan(blocked, (1, 10), (58, 10))
    plan = planner.plan(blocked, (5, 10 + REANCHOR_CELLS), (58, 10))
    assert not plan.from_scratch
    assert plan.reused_cells > 0
    far = planner.plan(blocked, (5, 25), (58, 10))
    assert far.from_scratch


def test_robot_walled_off_from_its_route_plans_from_scratch():
    blocked = np.zeros((30, 30), dtype=bool)
    planner = IAStar()
    planner.plan(blocked, (2, 10), (27, 10))
    blocked[12, :20] = True
    plan = planner.plan(blocked, (5, 14), (27, 10))
    assert plan.from_scratch
    assert plan.found


def test_reset_forgets():
    blocked = np.zeros((20, 20), dtype=bool)
    planner = IAStar()
    planner.plan(blocked, (1, 1), (18, 18))
    planner.reset()
    assert planner.plan(blocked, (1, 1), (18, 18)).from_scratch


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), corner_cutting=st.booleans())
def test_what_is_left_of_a_route_step_by_step(seed, corner_cutting):
    """Against the rules taken one at a time, on routes that may leave the window and return."""
    rng = np.random.default_rng(seed)
    blocked = rng.random((8, 9)) < 0.08
    steps = rng.choice([-1, 0, 1], (12, 2), p=[0.15, 0.15, 0.7])
    route = (rng.integers(-2, 5, 2) + np.cumsum(steps[steps.any(axis=1)], axis=0)).astype(np.int32)
    col, row = (int(v) for v in rng.integers(0, 8, 2))

    away = [sorted((abs(c - col), abs(r - row))) for c, r in route.tolist()]
    octile = [14 * less + 10 * (more - less) for less, more in away]
    first = max(i for i, distance in enumerate(octile) if distance == min(octile))
    rest = []
    for c, r in route[first:].tolist():
        if not (0 <= c < 9 and 0 <= r < 8):
            break
        rest.append((c, r))
    legal = not any(blocked[r, c] for c, r in rest)
    for (c, r), (next_c, next_r) in pairwise(rest):
        if c != next_c and r != next_r and not corner_cutting:
            legal = legal and not (blocked[r, next_c] or blocked[next_r, c])
    wanted = (first, first + len(rest)) if legal else (first, first)
    assert rest_of_route(blocked, route, col, row, corner_cutting) == wanted


def test_waypoint_of_least_f_from_the_end():
    """f by hand: straight towards the goal it is constant, and the last of equals is taken."""
    path = np.array([[0, 0], [1, 0], [2, 0], [3, 0], [3, 1]], dtype=np.int32)
    assert best_waypoint(path, 9, 0) == (3, 30)
    # A diagonal step costs 14 and brings the goal 20 nearer.
    diagonal = np.array([[0, 0], [1, 1], [2, 2]], dtype=np.int32)
    assert best_waypoint(diagonal, 5, 5) == (2, 28)


def test_direct_way_joins_any_two_cells():
    for to in [(4, 1), (-3, 5), (0, 0), (2, -2), (0, -6)]:
        for diagonal_first in (True, False):
            way = direct_way(0, 0, to[0], to[1], diagonal_first)
            assert tuple(way[0]) == (0, 0)
            assert tuple(way[-1]) == to
            assert len(way) == max(abs(to[0]), abs(to[1])) + 1
            assert (np.abs(np.diff(way, axis=0)).max(axis=1) == 1).all() if len(way) > 1 else True
