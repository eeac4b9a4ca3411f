from __future__ import annotations

import numpy as np
import pytest

from quadlog.mapping.grid import Window
from quadlog.mapping.inflation import inflate_square
from quadlog.pipelines.tables.following.table_2 import (
    SPEED_MPS,
    follow,
    follow_world,
)
from quadlog.pipelines.tables.planning.planner_walks import HONEST, PAPER
from quadlog.simulation.worlds.world import World, standing


def test_a_walk_straight_to_a_standing_person_is_known_in_closed_form():
    occupied = np.zeros((40, 80), dtype=np.bool_)
    occupied[30, 40] = True
    window = Window(0, 0, 0.1, (40, 80))
    world = World(window, occupied, np.array([1.05, 2.05]), standing(6.05, 2.05))
    followed = follow(world)
    assert followed.arrived
    assert followed.most_m == pytest.approx(5.0)
    # A replan each cell: 5.0, 4.9 ... 0.1 m away.
    assert followed.mean_m == pytest.approx(2.55)
    assert followed.clear_m == pytest.approx(1.0 - 0.05)


def test_who_stands_behind_walls_is_not_come_to():
    occupied = np.zeros((40, 80), dtype=np.bool_)
    occupied[10:31, 50:71] = True
    occupied[19:22, 59:62] = False
    world = World(Window(0, 0, 0.1, (40, 80)), occupied, np.array([1.05, 2.05]), standing(6.05, 2.05))
    followed = follow(world)
    assert not followed.arrived
    assert followed.clear_m >= world.dilation_m


@pytest.mark.parametrize("ahead_m", [2.0, 4.0])
def test_a_person_walks_evenly_round_the_trees_to_the_goal_of_the_forest(ahead_m):
    world = follow_world(0.2, 0, PAPER, 0, ahead_m)
    track = world.goal
    assert world.window_cells == 200
    legs_m = np.hypot(*np.diff(track.xy_m, axis=0).T)
    np.testing.assert_allclose(legs_m / np.diff(track.t_ns) * 1e9, SPEED_MPS, rtol=1e-6)
    assert track.t_ns[0] == 0
    cells = world.window.cell_of(track.xy_m)
    assert not inflate_square(world.occupied, 3)[cells[:, 1], cells[:, 0]].any()
    assert np.abs(np.diff(cells, axis=0)).max() == 1
    # As far ahead as there is way between, which is no shorter than the straight line.
    assert np.hypot(*(track.xy_m[0] - world.start_xy_m)) <= ahead_m + 0.15


def test_the_person_takes_the_same_way_for_every_preset_and_another_for_every_number():
    paper, honest = (follow_world(0.1, 2, preset, 0).goal for preset in (PAPER, HONEST))
    np.testing.assert_array_equal(paper.xy_m, honest.xy_m)
    assert not np.array_equal(follow_world(0.1, 3, PAPER, 0).goal.at(10**10), paper.at(10**10))


def test_the_window_always_holds_the_person():
    world = follow_world(0.2, 1, HONEST, 0, 8.0)
    assert world.speed_mps == SPEED_MPS
    assert np.hypot(*(world.goal.at(0) - world.start_xy_m)) < 10
