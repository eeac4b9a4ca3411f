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


def test_a_robot_that_fell_lies_still_while_time_goes_on(model):
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
