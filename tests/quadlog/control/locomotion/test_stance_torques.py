import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.control.locomotion.kinematics import leg_position
from quadlog.control.locomotion.leg_dynamics import (
    KNEE_BEHIND,
    KNEE_IN_FRONT,
    hip_reaction,
    stance_feet,
    stance_joints,
    stance_torques,
)
from quadlog.control.locomotion.robot import ROBOTS

ROBOT = ROBOTS["foot"]
LENGTHS = ROBOT.lengths
ANGLES = st.tuples(st.floats(-1.2, 1.2), st.floats(-1.5, 1.0), st.floats(-2.5, 2.5))
FORCE = st.tuples(*[st.floats(-100, 100)] * 3)
FIG_3 = 0.5 * np.array([0.08, 0.0, 9.81])
side = st.sampled_from([1.0, -1.0])


def torques(side, knee, force=FIG_3):
    feet = stance_feet(side, LENGTHS, 0.2, 0.05, 101)
    return stance_torques(stance_joints(feet, side, LENGTHS, knee), force, side, LENGTHS)


@pytest.mark.parametrize("knee", [KNEE_BEHIND, KNEE_IN_FRONT])
def test_fig_3s_numbers(knee):
    right, left = torques(-1.0, knee), torques(1.0, knee)
    # Lever of the force about each axis, by hand: L1 m g, and -(0.2 m a + x m g).
    np.testing.assert_allclose(right[:, 0], 0.07 * 0.5 * 9.81, rtol=1e-13)
    np.testing.assert_allclose(left[:, 0], -0.07 * 0.5 * 9.81, rtol=1e-13)
    x = np.linspace(0.025, -0.025, 101)
    np.testing.assert_allclose(right[:, 1], -0.5 * (0.2 * 0.08 + x * 9.81), atol=1e-14)
    assert right[[0, -1], 1].round(3).tolist() == [-0.131, 0.115]
    np.testing.assert_allclose(left[:, 1:], right[:, 1:], atol=1e-14)
    assert (knee * right[:, 2] < 0).all()


@given(ANGLES, side, FORCE, st.tuples(*[st.floats(-1, 1)] * 3))
def test_motors_and_ground_do_no_work_together(joints, side, force, rates):
    joints, rates, step = np.array(joints), np.array(rates), 1e-6
    ahead, back = np.empty(3), np.empty(3)
    leg_position(joints + step * rates, side, LENGTHS, ahead)
    leg_position(joints - step * rates, side, LENGTHS, back)
    ground_w = np.array(force) @ (ahead - back) / (2 * step)
    motors_w = stance_torques(joints[None], np.array(force), side, LENGTHS)[0] @ rates
    assert motors_w + ground_w == pytest.approx(0.0, abs=1e-6)


@given(ANGLES, side, FORCE)
def test_the_motors_feel_the_reaction_on_the_body_backwards(joints, side, force):
    joints, force, foot = np.array(joints), np.array(force), np.empty(3)
    leg_position(joints, side, LENGTHS, foot)
    couple = hip_reaction(foot[None], force)[0]
    hip_axis = [0, -np.cos(joints[0]), -np.sin(joints[0])]
    motors = stance_torques(joints[None], force, side, LENGTHS)[0]
    np.testing.assert_allclose([-couple[0], -(couple @ hip_axis)], motors[:2], atol=1e-12)
