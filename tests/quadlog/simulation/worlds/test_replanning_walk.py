from __future__ import annotations

import numpy as np
import pytest

from quadlog.mapping.goal_projection import INFLATIONS
from quadlog.mapping.grid import Window
from quadlog.planning.registry import make_planner
from quadlog.simulation.worlds import replanning_walk
from quadlog.simulation.worlds.replanning_walk import walk_world
from quadlog.simulation.worlds.scenes import forest_world
from quadlog.simulation.worlds.world import WaypointTrack, World, rectangles_in, standing


def ground(goal, boxes=(), moving=(), start=(0.05, 0.05), dilation_m=0.3):
    """Six metres about the origin, which nothing leaves, and two metres in view."""
    window = Window(-60, -60, 0.1, (120, 120))
    occupied = rectangles_in(window, boxes)
    goal = standing(*goal) if isinstance(goal, tuple) else goal
    return World(window, occupied, np.array(start), goal, moving, window_cells=40, dilation_m=dilation_m)


def steps_of(walk, world):
    """(N, 2) whole cells of the lattice that were stepped on."""
    return world.window.cell_of(walk.path_xy_m)


@pytest.mark.parametrize("goal", [(4.0, 1.3), (-1.2, 0.9), (-5.35, -5.35), (0.05, 5.0)])
def test_an_empty_world_is_crossed_by_an_octile_way(goal):
    world = ground(goal)
    walk = walk_world(world, make_planner("astar"))
    across, along = sorted(abs(world.window.cell_of(np.array(goal)) - world.window.cell_of(world.start_xy_m)))
    steps = np.abs(np.diff(steps_of(walk, world), axis=0))
    assert walk.arrived
    assert steps.max() == 1
    # Shortest over the whole way where it is straight or all in view; else the window's margin bends it somewhat.
    if along <= 19 or across in (0, along):
        assert (steps.sum(axis=1) == 2).sum() == across
        assert len(steps) == along
    else:
        assert along <= len(steps) <= along + across
    assert len(walk.plans) == len(walk.instants) == len(steps)


@pytest.mark.parametrize("dilation", sorted(INFLATIONS))
@pytest.mark.parametrize("leader", ["astar", "ia_star"])
def test_steps_through_forests_are_legal_and_keep_out_of_the_growth(leader, dilation):
    """On the world's own map: what has been seen is grown whole within 3 cells of the robot."""
    for seed in range(2):
        world = forest_world(0.3, np.random.default_rng([seed, 1]), dilation=dilation)
        walk = walk_world(world, make_planner(leader))
        assert walk.arrived
        grown = INFLATIONS[dilation](world.occupied, 3)
        cells = steps_of(walk, world)
        assert not grown[cells[:, 1], cells[:, 0]].any()
        for (col, row), (dcol, drow) in zip(cells[:-1], np.diff(cells, axis=0), strict=True):
            assert max(abs(dcol), abs(drow)) == 1
            assert not grown[row, col + dcol]
            assert not grown[row + drow, col]


def test_a_robot_in_the_growth_leaves_it_the_shortest_way_and_never_returns():
    world = ground((4.0, 0.05), boxes=[(-0.5, 0.2, 1.0, 0.6)])
    walk = walk_world(world, make_planner("astar"))
    grown = INFLATIONS["euclidean"](world.occupied, 3)
    cells = steps_of(walk, world)
    in_growth = grown[cells[:, 1], cells[:, 0]]
    # The wall is 2 cells away; its growth ends 3 cells from it.
    assert in_growth.tolist() == [True, True] + [False] * (len(cells) - 2)
    assert not world.occupied[cells[:, 1], cells[:, 0]].any()
    assert walk.arrived


def test_the_robot_waits_until_a_moving_obstacle_has_passed(monkeypatch):
    """A corridor in which somebody stands for 5 s, then walks off: no other way leads through."""
    walls = [(-6.0, 0.6, 6.0, 1.2), (-6.0, -1.1, 6.0, -0.5), (-6.0, -1.1, -0.6, 1.2)]
    away = WaypointTrack(np.array([5, 8]) * 10**9, np.array([[1.0, 0.05], [1.0, 5.0]]))
    world = ground((4.0, 0.05), walls, ((away, 0.5),))
    monkeypatch.setattr(replanning_walk, "PATIENCE", 100)
    walk = walk_world(world, make_planner("astar"))
    assert walk.arrived
    assert len(walk.instants) > len(walk.path_xy_m)
    monkeypatch.setattr(replanning_walk, "PATIENCE", 3)
    assert not walk_world(world, make_planner("astar")).arrived


def test_gives_up_when_walled_in():
    walls = [(-1.0, 0.6, 1.0, 1.0), (-1.0, -1.0, 1.0, -0.5), (-1.0, -1.0, -0.6, 1.0), (0.6, -1.0, 1.0, 1.0)]
    for dilation_m in (0.1, 0.6):
        walk = walk_world(ground((4.0, 0.05), walls, dilation_m=dilation_m), make_planner("astar"))
        assert not walk.arrived
        assert len(walk.plans) < 20 + replanning_walk.PATIENCE
        # Grown together there is nowhere to go, and no planner is asked.
        assert walk.plans[-1].found == (dilation_m == 0.1)


@pytest.mark.parametrize("leader", ["astar", "ia_star", "mt_d_star_lite"])
def test_the_same_walk_for_the_same_seed_whatever_the_planner_did_before(leader):
    planner = make_planner(leader)
    one, same = (walk_world(forest_world(0.2, np.random.default_rng(3)), planner) for _ in range(2))
    np.testing.assert_array_equal(one.path_xy_m, same.path_xy_m)
    for a, b in zip(one.instants, same.instants, strict=True):
        assert (a.t_ns, a.window, a.occupied.tobytes()) == (b.t_ns, b.window, b.occupied.tobytes())
    assert [plan.expanded for plan in one.plans] == [plan.expanded for plan in same.plans]
