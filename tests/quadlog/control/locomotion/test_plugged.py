"""A checked controller hands sound torques on, and names what is wrong with others; what it is given is consistent."""

from __future__ import annotations

import time

import numpy as np
import pytest

from quadlog.config.controllers import controller_plugin
from quadlog.control.locomotion.plugged import CheckedController, plugged_controller
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.control.locomotion.walker import WalkerSettings
from quadlog.errors import QuadlogError
from quadlog.plugins import CONTROLLERS as GROUP
from quadlog.plugins import Plugin
from quadlog.simulation.robot.height_field import flat
from quadlog.simulation.robot.model import quadruped_model
from quadlog.simulation.robot.walking_robot import WalkingRobot

PLUGIN = Plugin(GROUP, "odd", "quadlog-odd", "1.0", None)  # type: ignore[arg-type]
ROBOT = ROBOTS["tracking"]
ZERO = [0.0] * 12


@pytest.fixture(scope="module")
def model():
    return quadruped_model(ROBOT, flat())


def robot_by(model, step) -> WalkingRobot:
    """A standing robot whose every torque is step(t_s, state, wanted)."""

    class Odd:
        def __init__(self, robot, gait):
            assert (robot.mass_kg, gait.name) == (ROBOT.mass_kg, "trot")
            self.step = step

    settings = WalkerSettings(controller=lambda *given: CheckedController(PLUGIN, Odd, *given))
    return WalkingRobot(model, settings, np.array([1.0, 2.0, 0.5]), np.random.default_rng(0))


def fail(*_):
    raise KeyError("no\nleg")


@pytest.mark.parametrize(
    ("step", "reason"),
    [
        (lambda *_: None, "its torques are object (), not numbers (12,)"),
        (lambda *_: ZERO[1:], "its torques are float64 (11,), not numbers (12,)"),
        (lambda *_: [ZERO], "its torques are float64 (1, 12), not numbers (12,)"),
        (lambda *_: ["1"] * 12, "its torques are <U1 (12,), not numbers (12,)"),
        (lambda *_: [1j] * 12, "its torques are complex128 (12,), not numbers (12,)"),
        (lambda *_: [[1.0], *ZERO[1:]], "could not give torques: ValueError"),
        (lambda *_: [float("nan"), *ZERO[1:]], "its torques at 0.000 s are not finite: [nan, 0.0, 0.0"),
        (fail, "could not step: KeyError: 'no\\nleg'"),
    ],
)
def test_what_are_no_torques_is_refused(model, step, reason):
    with pytest.raises(QuadlogError) as raised:
        robot_by(model, step).walk(1, 0.0, 0.0)
    assert str(raised.value).startswith(f"controller odd of quadlog-odd 1.0: {reason}")
    assert "\n" not in str(raised.value)


def test_torques_are_cut_at_the_limits_and_cuts_are_counted(model):
    given = np.array([*range(-6, 5), 1e9])
    robot = robot_by(model, lambda *_: given)
    robot.walk(1, 0.0, 0.0)
    np.testing.assert_array_equal(robot.torques_nm, [*range(-6, 5), ROBOT.torque_limit_nm])
    assert (robot.effort.torque_max_nm, robot.effort.saturation_share) == (ROBOT.torque_limit_nm, 1 / 12)
    assert robot.counts == {}


def test_it_is_given_the_robots_state_and_the_commands(model):
    """State and dynamics agree with MuJoCo and each other; arrays are its own, and its time is its own."""
    seen = []

    def step(t_s, state, wanted):
        seen.append((t_s, state, wanted))
        time.sleep(0.002)
        return state.bias[6:] - sum(state.foot_jacobians[leg][:, 6:].T @ [0, 0, 0.25 * WEIGHT_N] for leg in range(4))

    WEIGHT_N = ROBOT.mass_kg * 9.81
    robot = robot_by(model, step)
    standing = robot.joints[model.joint_qpos]
    robot.walk(60, 0.5, 0.3, -0.1)
    (t_s, first, wanted), (_, last, told) = seen[0], seen[-1]
    assert (t_s, seen[1][0] - t_s) == (0.0, pytest.approx(0.002))
    np.testing.assert_array_equal(first.joints_rad, standing)
    np.testing.assert_allclose(first.position_m[:2], [1.0, 2.0])
    np.testing.assert_allclose([first.rpy_rad[2], wanted.rpy_rad[2]], 0.5, atol=2e-3)
    ground_m = first.feet_m[:, 2] - ROBOT.foot_radius_m
    np.testing.assert_allclose(ground_m, 0.0, atol=2e-3)
    assert wanted.height_m == pytest.approx(ROBOT.standing_height_m - ROBOT.foot_radius_m)
    np.testing.assert_allclose(last.bias[2], WEIGHT_N, rtol=1e-3)
    assert np.linalg.eigvalsh(last.mass_matrix).min() > 0
    # What the commands have become after a tenth of a second at 1 m/s^2: they turn with the heading.
    twist = told.forward_mps, told.left_mps, told.yaw_rate_radps
    np.testing.assert_allclose(twist, (0.12, -0.1, 0.3))
    yaw_rad = told.rpy_rad[2]
    heading = np.array([[np.cos(yaw_rad), np.sin(yaw_rad)], [-np.sin(yaw_rad), np.cos(yaw_rad)]])
    np.testing.assert_allclose(heading @ told.velocity_mps[:2], (0.12, -0.1), atol=1e-9)
    # Feet move as the Jacobians say.
    moved_mps = (seen[-1][1].feet_m - seen[-3][1].feet_m) / 0.004
    np.testing.assert_allclose(seen[-2][1].feet_mps, moved_mps, atol=0.05)
    assert not np.array_equal(first.position_m, last.position_m)
    assert robot.walker.took_s >= 0.002


@pytest.mark.parametrize("source", ["Mine = 5", "def Mine(robot, gait): pass", "class Mine: step = 1"])
def test_what_is_no_controller_is_refused(install, source):
    install("quadlog-mine", "1.0", {GROUP: {"mine": "mine:Mine", "fpmw": "mine:Mine"}}, {"mine": source})
    with pytest.raises(QuadlogError, match=r"controller mine of quadlog-mine 1\.0: is no controller"):
        plugged_controller(controller_plugin("mine"))
    with pytest.raises(QuadlogError, match="several have that name"):
        controller_plugin("fpmw")
