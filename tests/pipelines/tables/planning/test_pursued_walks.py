from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadlog.mapping.grid import Window
from quadlog.pipelines.tables.planning.planner_walks import HONEST, PAPER, forest_of
from quadlog.pipelines.tables.planning.table_1 import AT_GOAL_M, TICK_S, pursue
from quadlog.planning.registry import make_planner
from quadlog.simulation.worlds.world import Rectangle, World, rectangles_in, standing


def ground(goal_m, boxes=()):
    window = Window(-60, -60, 0.1, (120, 120))
    occupied = rectangles_in(window, [Rectangle(*box) for box in boxes])
    return World(window, occupied, np.array([0.05, 0.05]), standing(*goal_m))


def test_a_straight_way_takes_its_length_over_the_speed():
    world = ground((5.05, 0.05))
    walk = pursue(world, make_planner("astar"))
    assert walk.arrived
    assert walk.length_m == pytest.approx(5.0 - AT_GOAL_M, abs=0.05)
    assert walk.duration_s == pytest.approx(walk.length_m / world.speed_mps, abs=2 * TICK_S)
    assert walk.turning_radpm == pytest.approx(0.0, abs=1e-6)
    assert walk.clearance_m == np.inf


def test_a_detour_turns_and_keeps_its_distance():
    world = ground((5.05, 0.05), [(2.0, -0.5, 2.4, 0.5)])
    walk = pursue(world, make_planner("astar"))
    assert walk.arrived
    assert walk.length_m > 5.0
    assert walk.turning_radpm * walk.length_m > 0.5
    # The robot is half a metre wide, and obstacles grow by 0.3 m.
    assert -0.1 < walk.clearance_m < 0.3
    steps_m = np.hypot(*np.diff(walk.path_xy_m, axis=0).T)
    assert steps_m.max() <= world.speed_mps * TICK_S + 1e-9
    assert steps_m.sum() == pytest.approx(walk.length_m)


def test_a_robot_without_a_way_gives_up():
    walls = [(-1.0, 0.6, 1.0, 1.0), (-1.0, -1.0, 1.0, -0.5), (-1.0, -1.0, -0.6, 1.0), (0.6, -1.0, 1.0, 1.0)]
    assert not pursue(ground((4.0, 0.05), walls), make_planner("ia_star")).arrived
    assert not pursue(ground((5.05, 0.05)), make_planner("astar"), most_replans=3).arrived


@pytest.mark.parametrize("preset", [PAPER, HONEST], ids=lambda preset: preset.name)
def test_two_robots_walk_alike(preset):
    world = replace(forest_of(0.2, 0, preset, 0))
    first, second = (pursue(world, make_planner("ia_star", preset.rules)) for _ in range(2))
    np.testing.assert_array_equal(first.path_xy_m, second.path_xy_m)
    assert np.hypot(*(first.path_xy_m[-1] - world.goal.at(0))) <= AT_GOAL_M
