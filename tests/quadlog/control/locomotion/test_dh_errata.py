"""What [Foot] prints, beside what is right: the only place where the printed forms stand."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.kinematics import leg_jacobian, leg_position

L1, L2, L3 = LENGTHS = np.array([0.07, 0.21, 0.21])
# Frame {0} has x down, y left, z forward. Rows of Table 1, a right leg's: d, a and alpha of every link.
BODY_FROM_DH = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
TABLE_1 = np.array([[0, 0, 0], [L1, 0, math.pi / 2], [0, L2, 0], [0, L3, 0]])
JOINTS = np.random.default_rng(0).uniform([-0.8, -1.2, 0.3], [0.8, 0.4, 2.2], (50, 3))


def eq_2(joints, mended):
    (c1, c2, c3), (s1, s2, s3) = np.cos(joints), np.sin(joints)
    last = L3 * c3 * s2 if mended else L2 * c2 * s2
    x = L2 * c1 * c2 + L3 * c1 * c2 * c3 - L3 * c1 * s2 * s3
    y = L2 * c2 * s1 + L3 * c2 * c3 * s1 - L3 * s1 * s2 * s3
    return np.array([x, y, L1 + L2 * s2 + L3 * c2 * s3 + last])


def eq_4(joints, mended):
    t1, t2, t23 = joints[0], joints[1], joints[1] + joints[2]
    (c1, c2, c23), (s1, s2, s23) = np.cos([t1, t2, t23]), np.sin([t1, t2, t23])
    x, reach = L2 * s2 + L3 * s23, L2 * c2 + L3 * c23
    return np.array(
        [
            [0, reach, L3 * c23],
            [-L1 * s1 + c1 * reach, -s1 * x, (-1 if mended else 1) * L3 * s1 * s23],
            [L1 * c1 + s1 * reach, c1 * x, L3 * c1 * s23],
        ]
    )


def chain(rows, joints):
    """Where the foot is in frame {0}: each link turns about its z after it is placed by a and alpha [eq. 1]."""
    pose = np.eye(4)
    for theta, (d, a, alpha) in zip((*joints, 0.0), rows, strict=True):
        along_x, along_z = np.eye(4), np.eye(4)
        along_x[:3, :3], along_x[0, 3] = Rotation.from_euler("x", alpha).as_matrix(), a
        along_z[:3, :3], along_z[2, 3] = Rotation.from_euler("z", theta).as_matrix(), d
        pose = pose @ along_x @ along_z
    return pose[:3, 3]


@pytest.mark.parametrize("joints", JOINTS[:10])
def test_table_1_is_our_right_leg_and_eq_2_mended_is_it_with_l1_in_row_0(joints):
    foot, shifted = np.empty(3), TABLE_1.copy()
    leg_position(joints, -1.0, LENGTHS, foot)
    np.testing.assert_allclose(BODY_FROM_DH @ chain(TABLE_1, joints), foot, atol=1e-15)
    shifted[:2, 0] = L1, 0
    np.testing.assert_allclose(eq_2(joints, mended=True), chain(shifted, joints), atol=1e-15)
    assert np.abs(eq_2(joints, mended=True) - chain(TABLE_1, joints)).max() > 0.01


@pytest.mark.parametrize("joints", JOINTS[:10])
def test_eq_4_mended_is_the_left_legs_jacobian_in_the_body(joints):
    left, right = np.empty((3, 3)), np.empty((3, 3))
    leg_jacobian(joints, 1.0, LENGTHS, left)
    leg_jacobian(joints, -1.0, LENGTHS, right)
    np.testing.assert_allclose(eq_4(joints, mended=True), left, atol=1e-15)
    # The right one has L1 with the other sign, in the first column alone.
    l1_terms = L1 * np.array([0, -math.sin(joints[0]), math.cos(joints[0])])
    np.testing.assert_allclose(left[:, 0] - right[:, 0], 2 * l1_terms, atol=1e-15)
    np.testing.assert_array_equal(left[:, 1:], right[:, 1:])
    # In the frame of eq. 2 it is another matrix.
    assert np.abs(BODY_FROM_DH.T @ left - left).max() > 0.05


def test_eq_4_as_printed_differs_in_one_entry():
    off = np.array([eq_4(joints, mended=False) - eq_4(joints, mended=True) for joints in JOINTS])
    expected = 2 * L3 * np.sin(JOINTS[:, 0]) * np.sin(JOINTS[:, 1] + JOINTS[:, 2])
    np.testing.assert_allclose(off[:, 1, 2], expected, atol=1e-15)
    off[:, 1, 2] = 0
    assert not off.any()
    assert np.abs(expected).max() > 0.1


def test_fig_3s_abduction_torque_of_zero_contradicts_the_papers_own_equations():
    # Eqs 4 to 6 with Table 2's numbers, at the middle of the stance: -J' f, first row.
    half_knee = math.acos(0.2 / (L2 + L3))
    standing = np.array([0.0, -half_knee, 2 * half_knee])
    force = 0.5 * np.array([0.08, 0.0, 9.81])
    assert -(eq_4(standing, mended=False).T @ force)[0] == pytest.approx(-L1 * 0.5 * 9.81)
