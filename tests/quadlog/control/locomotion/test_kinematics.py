import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.kinematics import foot_positions, joints_for, leg_inverse, leg_jacobian, leg_position
from quadlog.control.locomotion.robot import ROBOTS, SIDES

LENGTHS = np.array([0.075, 0.22, 0.22])
UNEVEN = np.array([0.08, 0.25, 0.2])
ANGLES = st.tuples(st.floats(-1.4, 1.4), st.floats(-2.0, 1.0), st.floats(0.05, 2.8))
SIGNS = np.array([1, -1, -1])
side = st.sampled_from([1.0, -1.0])
lengths = st.sampled_from([LENGTHS, UNEVEN])


def position(joints, side, lengths):
    foot = np.empty(3)
    leg_position(np.asarray(joints, float), side, lengths, foot)
    return foot


def inverse(foot, side, lengths):
    joints = np.empty(3)
    return joints, leg_inverse(np.asarray(foot, float), side, lengths, joints)


@given(ANGLES, side, lengths)
def test_the_foot_is_at_the_end_of_three_turned_links(joints, side, lengths):
    abduction, hip, knee = (Rotation.from_euler(axis, t) for axis, t in zip("xyy", joints * SIGNS, strict=True))
    thigh, shank = np.array([0, 0, -lengths[1]]), np.array([0, 0, -lengths[2]])
    expected = abduction.apply(np.array([0, side * lengths[0], 0]) + hip.apply(thigh + knee.apply(shank)))
    np.testing.assert_allclose(position(joints, side, lengths), expected, atol=1e-15)


@given(ANGLES, side, lengths)
def test_joints_for_a_foot_bring_it_back(joints, side, lengths):
    foot = position(joints, side, lengths)
    again, reached = inverse(foot, side, lengths)
    assert reached
    assert np.abs(position(again, side, lengths) - foot).max() <= 6e-15
    assert 0 <= again[2] <= math.pi


everywhere = st.floats(-1e9, 1e9) | st.floats(-0.6, 0.6) | st.sampled_from([0.0, -0.0, 1e-300, 0.075, 0.44])


@given(st.tuples(everywhere, everywhere, everywhere), side, lengths)
def test_any_target_gets_joints_and_the_nearest_distance(foot, side, lengths):
    joints, reached = inverse(foot, side, lengths)
    assert np.isfinite(joints).all()
    assert (np.abs(joints) <= 2 * math.pi).all()
    end = position(joints, side, lengths)
    if reached:
        # Where the leg is stretched, the knee's angle is known to the root of what floats tell.
        np.testing.assert_allclose(end, foot, atol=5e-8)
    far = math.hypot(*foot) > math.hypot(lengths[0], lengths[1] + lengths[2]) + 1e-9
    assert not (far and reached)
    if far:
        # Stretched: cos of a knee angle of 1e-8 is 1 in floating point.
        assert joints[2] <= 1e-7


@given(ANGLES, side, lengths)
def test_the_jacobian_is_the_derivative(joints, side, lengths):
    jacobian, step = np.empty((3, 3)), 1e-6
    leg_jacobian(np.array(joints), side, lengths, jacobian)
    for k, unit in enumerate(np.eye(3)):
        ahead, back = (position(joints + sign * step * unit, side, lengths) for sign in (1, -1))
        np.testing.assert_allclose(jacobian[:, k], (ahead - back) / (2 * step), atol=5e-10)


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=list(ROBOTS))
def test_all_legs_at_once_are_the_single_legs(robot):
    rng = np.random.default_rng(0)
    joints = robot.standing_joints_rad + rng.uniform(-0.3, 0.3, 12)
    feet, again = np.empty((4, 3)), np.empty(12)
    foot_positions(joints, robot.hips_m, robot.lengths, feet)
    for leg in range(4):
        own = joints[3 * leg : 3 * leg + 3]
        np.testing.assert_array_equal(feet[leg], position(own, SIDES[leg], robot.lengths) + robot.hips_m[leg])
    assert joints_for(feet, robot.hips_m, robot.lengths, again)
    np.testing.assert_allclose(again, joints, atol=1e-13)
    feet[2] *= 3
    assert not joints_for(feet, robot.hips_m, robot.lengths, again)
