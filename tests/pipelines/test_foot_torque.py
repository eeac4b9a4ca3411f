import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.control.locomotion.kinematics import leg_position
from quadlog.pipelines.simulation.trot import FootCycle
from quadlog.pipelines.tables.foot_torque import (
    HEIGHT_M,
    LIFT_M,
    PERIOD_S,
    ROBOT,
    STRIDE_M,
    SWING_POINTS,
    stance_torques,
    swing_hip_reaction,
    torques_of,
)

ANGLES = st.tuples(st.floats(-1.2, 1.2), st.floats(-1.5, 1.0), st.floats(-2.5, 2.5))
THREE = st.tuples(*[st.floats(-100, 100)] * 3)


def test_fig_3s_numbers():
    right, left = torques_of(-1.0, 0.5), torques_of(1.0, 0.5)
    # Lever of the force about each axis, by hand: L1 m g, and -(0.2 m a + x m g).
    np.testing.assert_allclose(right[:, 0], 0.07 * 0.5 * 9.81, rtol=1e-13)
    np.testing.assert_allclose(left[:, 0], -0.07 * 0.5 * 9.81, rtol=1e-13)
    x = np.linspace(0.025, -0.025, 101)
    np.testing.assert_allclose(right[:, 1], -0.5 * (0.2 * 0.08 + x * 9.81), atol=1e-14)
    assert right[[0, -1], 1].round(3).tolist() == [-0.131, 0.115]
    np.testing.assert_allclose(left[:, 1:], right[:, 1:], atol=1e-14)
    assert (right[:, 2] < 0).all()


@given(ANGLES, st.sampled_from([1.0, -1.0]), THREE, THREE)
def test_motors_and_ground_do_no_work_together(joints, side, force, rates):
    joints, rates, step = np.array(joints), 0.01 * np.array(rates), 1e-6
    ahead, back = np.empty(3), np.empty(3)
    leg_position(joints + step * rates, side, ROBOT.lengths, ahead)
    leg_position(joints - step * rates, side, ROBOT.lengths, back)
    ground_w = np.array(force) @ (ahead - back) / (2 * step)
    assert stance_torques(joints[None], np.array(force), side)[0] @ rates + ground_w == pytest.approx(0.0, abs=1e-6)


def test_a_slow_swing_pushes_by_its_weight_and_a_fast_one_by_what_speeds_it_up():
    """Thigh .18 kg .15 of its length below the hip, shank .07 kg in its middle, foot .03 kg at its end."""
    slow, still = swing_hip_reaction(9.81, 1e4), swing_hip_reaction(0.0, 1e4)
    down, behind = 0.2 / 2, 0.025 / 2  # of the knee from the middle of hip and foot
    along = np.sqrt(0.21**2 - down**2 - behind**2) / np.hypot(down, behind)
    hip_to_knee_m = -behind - along * down
    weight = 0.18 * 0.15 * hip_to_knee_m + 0.07 * (hip_to_knee_m - 0.025) / 2 - 0.03 * 0.025
    assert slow[0] == pytest.approx(-9.81 * weight, rel=1e-3)
    assert np.abs(still).max() < 1e-8
    np.testing.assert_allclose(swing_hip_reaction(0.0)[20:-20], -_momentum_gain()[20:-20], atol=2e-3)


def _momentum_gain() -> np.ndarray:
    """What a leg's angular momentum about its hip, backwards positive, gains in a swing of Table 2: by hand, in 2-D."""
    t_s = np.linspace(0.0, PERIOD_S / 2, SWING_POINTS)
    foot = FootCycle(PERIOD_S, STRIDE_M, LIFT_M).at(t_s)[:, ::2] - [0.0, HEIGHT_M]
    away = np.hypot(*foot.T)
    knee = foot / 2 + np.sqrt(0.21**2 / away**2 - 0.25)[:, None] * foot[:, ::-1] * [1, -1]
    momentum = 0.0
    for mass, place in ((0.18, 0.15 * knee), (0.07, (knee + foot) / 2), (0.03, foot)):
        (x, z), (vx, vz) = place.T, np.gradient(place, t_s, axis=0).T
        momentum = momentum + mass * (x * vz - z * vx)
    for inertia, rod in (
        (0.18 * (3 * 0.045**2 + 0.21**2) / 12, knee),
        (0.07 * (3 * 0.012**2 + 0.21**2) / 12 + 0.4 * 0.03 * 0.02**2, foot - knee),
    ):
        momentum = momentum + inertia * np.gradient(np.unwrap(np.arctan2(rod[:, 1], rod[:, 0])), t_s)
    return np.gradient(momentum, t_s)
