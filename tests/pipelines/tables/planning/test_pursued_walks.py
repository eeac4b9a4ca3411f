from __future__ import annotations

import numpy as np
import pytest

from quadlog.mapping.grid import Window
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


def test_a_robot_without_a_way_gives_up():
    walls = [(-1.0, 0.6, 1.0, 1.0), (-1.0, -1.0, 1.0, -0.5), (-1.0, -1.0, -0.6, 1.0), (0.6, -1.0, 1.0, 1.0)]
    assert not pursue(ground((4.0, 0.05), walls), make_planner("ia_star")).arrived
    assert not pursue(ground((5.05, 0.05)), make_planner("astar"), most_replans=3).arrived
