import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from quadlog.control.locomotion.kinematics import leg_inverse, leg_position

LENGTHS = np.array([0.075, 0.22, 0.22])
UNEVEN = np.array([0.08, 0.25, 0.2])
ANGLES = st.tuples(st.floats(-1.4, 1.4), st.floats(-2.0, 1.0), st.floats(0.05, 2.8))
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
