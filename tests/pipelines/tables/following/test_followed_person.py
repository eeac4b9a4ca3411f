from __future__ import annotations

import numpy as np
import pytest

from quadlog.mapping.grid import Window
from quadlog.pipelines.tables.following.table_2 import AHEAD_M, Followed, _rows, follow, person_group
from quadlog.pipelines.tables.planning.planner_walks import DENSITIES_PER_M2
from quadlog.simulation.worlds.world import GROWTH_M, World, standing


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


def test_rows_name_what_there_is_and_leave_out_what_there_is_not():
    walks = [Followed(True, 2.0, 4.0, np.inf), Followed(False, 3.0, 4.0, np.inf)]
    rows = _rows(walks, "here", np.random.default_rng(0))
    assert [row.ours for row in rows] == [0.5, 2.5, 4.0]
    assert rows[0].note == "1 of 2."
    assert rows[1].note == "2.00 to 3.00."
    assert rows[1].low <= 2.5 <= rows[1].high


def test_a_person_is_followed_off_obstacles_and_no_farther_than_the_way_ahead():
    rows = {row.quantity: row for row in person_group(1, 0).rows}
    for row in rows.values():
        if "distance to the person" in row.quantity:
            assert 0 < row.ours <= AHEAD_M + 0.2
        if "to an obstacle" in row.quantity:
            assert row.ours >= GROWTH_M
    assert sum("to an obstacle" in quantity for quantity in rows) == len(DENSITIES_PER_M2)
