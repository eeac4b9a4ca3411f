"""What studies measure, against closed forms and by properties of the walks."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from quadlog.mapping.grid import Window
from quadlog.mapping.inflation import inflate_square
from quadlog.pipelines.simulation.walk import disturbance_settings, lookahead_control
from quadlog.pipelines.tables import foot_torque, planning_1
from quadlog.pipelines.tables.following_2 import SPEED_MPS, follow_world
from quadlog.pipelines.tables.planning_2 import CELL_RATIO, PAPER, PRESETS, PRINTED_RATIO, cells, lead
from quadlog.pipelines.tables.planning_ea import clearance_cells
from quadlog.pipelines.tables.tracking_5 import config_of, track
from quadlog.planning.registry import make_planner
from quadlog.simulation.robot.disturbances import DISTURBED, NONE
from quadlog.simulation.worlds.world import Rectangle, World, rectangles_in, standing


def ground(goal_m, boxes=()):
    window = Window(-60, -60, 0.1, (120, 120))
    return World(
        window, rectangles_in(window, [Rectangle(*box) for box in boxes]), np.array([0.05, 0.05]), standing(*goal_m)
    )


def test_a_straight_way_takes_its_length_over_the_speed():
    world = ground((5.05, 0.05))
    found = planning_1.pursue(world, make_planner("astar"))
    assert found["arrived"] == found["clean"] == 1.0
    assert found["length_m"] == pytest.approx(5.0 - planning_1.AT_GOAL_M, abs=0.05)
    assert found["time_s"] == pytest.approx(found["length_m"] / world.speed_mps, abs=2 * planning_1.TICK_S)


def test_a_robot_without_a_way_gives_up():
    walls = [(-1.0, 0.6, 1.0, 1.0), (-1.0, -1.0, 1.0, -0.5), (-1.0, -1.0, -0.6, 1.0), (0.6, -1.0, 1.0, 1.0)]
    found = planning_1.pursue(ground((4.0, 0.05), walls), make_planner("ia_star"))
    assert (found["arrived"], found["clean"]) == (0.0, 0.0)
    assert "length_m" not in found


def person_at_6_m() -> World:
    occupied = np.zeros((40, 80), dtype=np.bool_)
    occupied[30, 40] = True
    return World(Window(0, 0, 0.1, (40, 80)), occupied, np.array([1.05, 2.05]), standing(6.05, 2.05))


@pytest.mark.parametrize("preset", PRESETS)
def test_cells_are_those_of_the_same_questions(preset):
    world, of = person_at_6_m(), PRESETS[preset]
    found = cells(world, lead(world, of), of)
    assert found["ratio"] == found["cells_astar"] / found["cells_ia_star"]
    assert found["above"] == (found["ratio"] > 5)
    assert found["replans"] == 50


def test_a_walk_that_does_not_arrive_has_no_ratio():
    world = person_at_6_m()
    world.occupied[10:31, 50:71] = True
    world.occupied[19:22, 59:62] = False
    assert cells(world, lead(world, PAPER), PAPER) == {"arrived": 0.0}


def test_a_person_walks_evenly_round_the_trees_the_same_way_for_every_preset():
    world = follow_world(0.2, 0, PAPER.dilation, 0)
    track_of = world.goal
    legs_m = np.hypot(*np.diff(track_of.xy_m, axis=0).T)
    np.testing.assert_allclose(legs_m / np.diff(track_of.t_ns) * 1e9, SPEED_MPS, rtol=1e-6)
    way = world.window.cell_of(track_of.xy_m)
    assert not inflate_square(world.occupied, 3)[way[:, 1], way[:, 0]].any()
    assert np.abs(np.diff(way, axis=0)).max() == 1
    assert np.hypot(*(track_of.xy_m[0] - world.start_xy_m)) <= 4.15
    np.testing.assert_array_equal(follow_world(0.2, 0, "euclidean", 0).goal.xy_m, track_of.xy_m)
    assert not np.array_equal(follow_world(0.2, 1, PAPER.dilation, 0).goal.at(10**10), track_of.at(10**10))


def test_clearance_is_the_least_of_all_pairs():
    rng = np.random.default_rng(0)
    occupied = rng.random((9, 12)) < 0.1
    occupied[0, 0] = True
    path = np.argwhere(~occupied)[:, ::-1][rng.integers(0, (~occupied).sum(), size=5)].astype(np.int32)
    apart = np.abs(path[:, None] - np.argwhere(occupied)[None, :, ::-1])
    assert clearance_cells(occupied, path) == apart.max(axis=2).min()


def test_the_printed_ratios_are_cut_off_where_the_errata_say_so():
    cut = [run + 1 for run in range(9) if round(CELL_RATIO[run], 2) != PRINTED_RATIO[run]]
    assert cut == [4, 5, 6, 7]


def test_the_legs_own_weight_is_all_of_a_swings_reaction_over_the_whole_swing():
    # At rest at both ends, a leg's angular momentum gains nothing.
    assert foot_torque.swing_hip_reaction(0.0).mean() == pytest.approx(0, abs=5e-4)
    assert foot_torque.swing_hip_reaction(9.81).mean() > 0.1
    np.testing.assert_allclose(
        foot_torque.swing_hip_reaction(0.0, 0.25), 4 * foot_torque.swing_hip_reaction(0.0), atol=1e-9
    )


def test_controllers_are_those_of_simulate():
    for name in ("FpMW", "FpM", "pMW"):
        assert config_of("course", name, False).simulation.controller == name.lower()
    assert lookahead_control(config_of("course", "pMW", False)).step(0.1, 0.02, 0.5).l_m == 2.0
    for disturbed, settings in ((True, DISTURBED), (False, NONE)):
        found = disturbance_settings(config_of("course", "pMW", disturbed).simulation.disturbances)
        assert asdict(found) == asdict(settings)


def test_a_short_walk_has_the_figures_of_its_rows(tmp_path):
    path = tmp_path / "short.csv"
    path.write_text("x_m,y_m\n" + "".join(f"{x_m:.2f},0\n" for x_m in np.arange(0, 2.01, 0.1)))
    found = track(str(path), "3cm", "FpMW", "disturbed", 2000)
    assert 0 < found["eta_m"] < 0.05
    assert 3 < found["completion_time_s"] < 4.5
    assert found["fallen"] == 0
