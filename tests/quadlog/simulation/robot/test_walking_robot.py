from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from quadlog.control.locomotion.robot import ROBOTS
from quadlog.control.locomotion.walker import WalkerSettings
from quadlog.pipelines.simulation.trot import TrotRobot, trot_model
from quadlog.simulation.robot import height_field as ground
from quadlog.simulation.robot.disturbances import NONE
from quadlog.simulation.robot.model import quadruped_model
from quadlog.simulation.robot.walking_robot import WalkingRobot
from quadlog.simulation.settings import DisturbanceSettings

ROBOT = ROBOTS["tracking"]
START = np.array([1.0, 2.0, 0.5])


@pytest.fixture(scope="module")
def model():
    return quadruped_model(ROBOT, ground.flat())


def _robot(model, disturbances=NONE, **settings) -> WalkingRobot:
    return WalkingRobot(model, WalkerSettings(**settings), START, np.random.default_rng(0), disturbances)


@pytest.fixture(scope="module")
def walked(model):
    """After a second at 0.4 m/s, and what its feet carried on the way."""
    robot, loads = _robot(model), []
    for _ in range(50):
        robot.walk(10, 0.4, 0.0)
        loads.append(robot.foot_loads_n.sum())
    return robot, np.array(loads)


def test_the_robot_starts_at_its_start_pose(model):
    robot = _robot(model)
    np.testing.assert_allclose(robot.pose, START, atol=1e-9)
    assert robot.position_m[2] == pytest.approx(ROBOT.standing_height_m, abs=1e-3)
    assert robot.t_s == 0
    assert not robot.fallen


def test_the_robot_walks_at_the_commanded_speed(walked):
    robot, _ = walked
    assert robot.t_s == pytest.approx(1.0)
    assert not robot.fallen
    moved = robot.pose[:2] - START[:2]
    along = moved @ [math.cos(0.5), math.sin(0.5)]
    # Up to 0.4 m/s at 1 m/s^2 loses 0.08 m; the body lags a little more.
    assert 0.22 < along < 0.36
    assert abs(moved @ [-math.sin(0.5), math.cos(0.5)]) < 0.02
    assert robot.pose[2] == pytest.approx(0.5, abs=0.03)
    assert robot.velocity[0] == pytest.approx(0.4, abs=0.08)


def test_its_feet_carry_its_weight(walked):
    _, loads = walked
    assert loads[10:].mean() == pytest.approx(ROBOT.mass_kg * 9.81, rel=0.08)


def test_effort_is_summed_over_all_ticks(walked):
    robot, _ = walked
    effort = robot.effort
    way_m = np.hypot(*(robot.pose[:2] - START[:2]))
    assert 2 < effort.torque_max_nm <= ROBOT.torque_limit_nm
    assert 0 <= effort.saturation_share <= 1
    assert 0.1 < effort.energy_j / (robot.mass_kg * 9.81 * way_m) < 5
    assert effort.pitch_rms_rad < 0.03
    assert effort.height_rms_m < 0.01


def test_the_robot_turns_at_the_commanded_yaw_rate(model):
    robot = _robot(model)
    robot.walk(400, 0.2, 0.5)
    assert robot.pose[2] - 0.5 == pytest.approx(0.5 * 0.8 - 0.5 * 0.5**2 / 4, abs=0.08)


def test_pushes_move_the_robot_and_strong_ones_make_it_fall(model):
    pushed = _robot(model, DisturbanceSettings(push_n=60.0, push_s=0.1, push_every_s=0.2))
    calm = _robot(model)
    for robot in (pushed, calm):
        robot.walk(175, 0.0, 0.0)
    sideways = np.array([-math.sin(0.5), math.cos(0.5)])
    assert abs((pushed.pose - calm.pose)[:2] @ sideways) > 0.01
    assert not pushed.fallen
    felled = _robot(model, DisturbanceSettings(push_n=2000.0, push_s=0.2, push_every_s=0.1))
    felled.walk(505, 0.0, 0.0)
    assert felled.fallen
    assert felled.t_s == pytest.approx(1.01)
    lying = felled.pose
    felled.walk(10, 0.6, 0.0)
    np.testing.assert_array_equal(felled.pose, lying)
    assert felled.t_s == pytest.approx(1.03)


@pytest.mark.parametrize("name", ["b1", "foot"])
def test_heavy_and_light_robots_walk_without_settings_of_their_own(name):
    robot = WalkingRobot(
        quadruped_model(ROBOTS[name], ground.flat()), WalkerSettings(), START, np.random.default_rng(0)
    )
    robot.walk(750, 0.3, 0.0)
    assert not robot.fallen
    assert math.dist(robot.pose[:2], START[:2]) == pytest.approx(0.4, abs=0.06)


def test_counts_and_effort_go_on_where_the_robot_starts_again(model):
    robot = _robot(model)
    robot.walk(100, 0.4, 0.0)
    before, energy_j = robot.counts["mpc_solves"], robot.effort.energy_j
    robot.start_at(START)
    assert (robot.counts["mpc_solves"], robot.effort.energy_j) == (before, energy_j)
    robot.walk(100, 0.4, 0.0)
    assert robot.counts["mpc_solves"] == 2 * before


def test_models_without_damping_step_explicitly_to_the_same_place(model):
    assert model.model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    implicit = quadruped_model(ROBOT, ground.flat())
    implicit.model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    walks = [_robot(each) for each in (model, implicit)]
    for each in walks:
        each.walk(400, 0.5, 0.2)
    np.testing.assert_allclose(walks[0].position_m, walks[1].position_m, atol=1e-6)
    assert trot_model(TrotRobot()).model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST


def test_a_callback_for_warnings_of_mujoco_is_put_back(model):
    before, own = mujoco.get_mju_user_warning(), lambda _: None
    try:
        mujoco.set_mju_user_warning(own)
        _robot(model).walk(1, 0.0, 0.0)
        assert mujoco.get_mju_user_warning() is own
    finally:
        mujoco.set_mju_user_warning(before)


def test_the_same_walk_twice_is_bitwise_the_same(model):
    first, second = _robot(model), _robot(model)
    for robot in (first, second):
        robot.walk(100, 0.5, 0.2)
    np.testing.assert_array_equal(first.joints, second.joints)
    np.testing.assert_array_equal(first.torques_nm, second.torques_nm)
