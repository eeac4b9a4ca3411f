import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.kinematics import foot_positions, leg_position
from quadlog.control.locomotion.leg_dynamics import (
    BODY_FROM_DH,
    KNEE_BEHIND,
    KNEE_IN_FRONT,
    dh_frames,
    dh_inverse,
    dh_rows,
    dh_transform,
)
from quadlog.control.locomotion.robot import ROBOTS, SIDES

FOOT = np.array([0.07, 0.21, 0.21])
UNEVEN = np.array([0.08, 0.25, 0.2])
ANGLES = st.tuples(st.floats(-1.4, 1.4), st.floats(-2.0, 2.0), st.floats(-2.8, 2.8))
BELOW = st.tuples(st.floats(-0.8, 0.8), st.floats(-0.5, 0.5), st.floats(0.05, 2.8))
side = st.sampled_from([1.0, -1.0])
lengths = st.sampled_from([FOOT, UNEVEN])
knee = st.sampled_from([KNEE_BEHIND, KNEE_IN_FRONT])


def pose(turn, place):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn.as_matrix(), place
    return matrix


def dh_position(joints, side, lengths):
    return dh_frames(joints, side, lengths)[3, :3, 3]


def bent(abduction, towards, knee_angle, knee):
    """Joints whose foot is in a direction from the hip: equal links."""
    return np.array([abduction, towards - knee * knee_angle / 2, knee * knee_angle])


@settings(deadline=None)
@given(st.floats(-4, 4), st.floats(-1, 1), st.floats(-1, 1), st.floats(-4, 4))
def test_a_link_is_two_screws(theta, d, a, alpha):
    along_x = pose(Rotation.from_euler("x", alpha), [a, 0, 0])
    along_z = pose(Rotation.from_euler("z", theta), [0, 0, d])
    np.testing.assert_allclose(dh_transform(theta, d, a, alpha), along_x @ along_z, atol=1e-15)


def test_the_right_legs_rows_are_table_1():
    expected = [[0, 0, 0], [0.07, 0, math.pi / 2], [0, 0.21, 0], [0, 0.21, 0]]
    np.testing.assert_array_equal(dh_rows(-1.0, FOOT), expected)


@settings(deadline=None)
@given(ANGLES, lengths)
def test_table_1s_chain_is_the_written_out_right_leg(joints, lengths):
    l1, l2, l3 = lengths
    t1, t2, t23 = joints[0], joints[1], joints[1] + joints[2]
    reach = l2 * math.cos(t2) + l3 * math.cos(t23)
    expected = [
        math.cos(t1) * reach + l1 * math.sin(t1),
        math.sin(t1) * reach - l1 * math.cos(t1),
        l2 * math.sin(t2) + l3 * math.sin(t23),
    ]
    np.testing.assert_allclose(dh_position(joints, -1.0, lengths), expected, atol=1e-15)


@settings(deadline=None)
@given(ANGLES, side, lengths)
def test_the_position_is_that_of_the_body_frame(joints, side, lengths):
    foot = np.empty(3)
    leg_position(np.array(joints), side, lengths, foot)
    p = dh_position(joints, side, lengths)
    np.testing.assert_allclose([p[2], p[1], -p[0]], foot, atol=1e-15)


@settings(deadline=None)
@given(ANGLES, lengths)
def test_the_left_leg_mirrors_the_right_one(joints, lengths):
    mirrored = dh_position([-joints[0], *joints[1:]], 1.0, lengths)
    np.testing.assert_allclose(dh_position(joints, -1.0, lengths) * [1, -1, 1], mirrored, atol=1e-15)


@settings(deadline=None)
@given(ANGLES, side, lengths, knee)
def test_joints_for_a_foot_bring_it_back_with_the_knee_where_it_is_wanted(joints, side, lengths, knee):
    foot = dh_position(joints, side, lengths)
    again, reached = dh_inverse(foot, side, lengths, knee)
    frames = dh_frames(again, side, lengths)
    # Near a stretched leg the knee's angle is known to the root of what floats tell.
    np.testing.assert_allclose(frames[3, :3, 3], foot, atol=3e-8 if abs(joints[2]) < 0.01 else 2e-14)
    assert reached
    # In the leg's plane, along which the hip's axis is z: behind is against the way the hip turns the foot.
    way = frames[3, :3, 3] - frames[1, :3, 3]
    assert knee * (frames[1, :3, 2] @ np.cross(frames[2, :3, 3] - frames[1, :3, 3], way)) >= -1e-15
    assert knee * again[2] >= 0


@settings(deadline=None)
@given(BELOW, side, knee)
def test_joints_come_back_where_the_leg_hangs_below_its_hip(angles, side, knee):
    joints = bent(*angles, knee)
    again, _ = dh_inverse(dh_position(joints, side, FOOT), side, FOOT, knee)
    np.testing.assert_allclose(again, joints, atol=1e-13)


@pytest.mark.parametrize("knee", [KNEE_BEHIND, KNEE_IN_FRONT])
def test_a_standing_knee_is_behind_or_in_front(knee):
    joints, reached = dh_inverse([0.2, -0.07, 0.0], -1.0, FOOT, knee)
    assert reached
    forward_m = dh_frames(joints, -1.0, FOOT)[2, 2, 3]
    assert np.sign(forward_m) == -knee


@settings(deadline=None)
@given(st.tuples(*[st.floats(-1e6, 1e6) | st.floats(-0.6, 0.6)] * 3), side, lengths, knee)
def test_any_target_gets_joints_and_both_knees_end_at_one_place(foot, side, lengths, knee):
    joints, reached = dh_inverse(foot, side, lengths, knee)
    assert np.isfinite(joints).all()
    other, also = dh_inverse(foot, side, lengths, -knee)
    assert reached == also
    np.testing.assert_allclose(dh_position(joints, side, lengths), dh_position(other, side, lengths), atol=1e-13)
    far = math.hypot(*foot) > math.hypot(lengths[0], lengths[1] + lengths[2]) + 1e-9
    near = math.hypot(*foot) < math.hypot(lengths[0], lengths[1] - lengths[2]) - 1e-9
    assert not ((far or near) and reached)


def test_a_foot_too_far_is_approached_with_a_straight_leg():
    for knee in (KNEE_BEHIND, KNEE_IN_FRONT):
        joints, reached = dh_inverse([0.6, -0.07, 0.3], -1.0, FOOT, knee)
        assert not reached
        expected = np.array([0.6, 0, 0.3]) * 0.42 / math.hypot(0.6, 0.3) - [0, 0.07, 0]
        np.testing.assert_allclose(dh_position(joints, -1.0, FOOT), expected, atol=1e-8)


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=list(ROBOTS))
def test_all_four_legs_stand_where_the_robot_does(robot):
    feet = np.empty((4, 3))
    foot_positions(robot.standing_joints_rad, robot.hips_m, robot.lengths, feet)
    for leg, side in enumerate(SIDES):
        joints, reached = dh_inverse(BODY_FROM_DH.T @ (feet[leg] - robot.hips_m[leg]), side, robot.lengths, KNEE_BEHIND)
        assert reached
        np.testing.assert_allclose(joints, robot.standing_joints_rad[3 * leg : 3 * leg + 3], atol=1e-13)
