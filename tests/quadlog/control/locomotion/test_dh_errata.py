"""A leg against the chain and the Jacobian that [Foot] prints."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.kinematics import leg_jacobian, leg_position

L1, L2, L3 = LENGTHS = np.array([0.07, 0.21, 0.21])
# Frame {0} has x down, y left, z forward. Rows of Table 1, a right leg's: d, a and alpha of every link.
BODY_FROM_DH = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
TABLE_1 = np.array([[0, 0, 0], [L1, 0, math.pi / 2], [0, L2, 0], [0, L3, 0]])
JOINTS = np.random.default_rng(0).uniform([-0.8, -1.2, 0.3], [0.8, 0.4, 2.2], (10, 3))


def eq_4(joints):
    """As mended: the last entry of its middle row is printed with the other sign."""
    t1, t2, t23 = joints[0], joints[1], joints[1] + joints[2]
    (c1, c2, c23), (s1, s2, s23) = np.cos([t1, t2, t23]), np.sin([t1, t2, t23])
    x, reach = L2 * s2 + L3 * s23, L2 * c2 + L3 * c23
    return np.array(
        [
            [0, reach, L3 * c23],
            [-L1 * s1 + c1 * reach, -s1 * x, -L3 * s1 * s23],
            [L1 * c1 + s1 * reach, c1 * x, L3 * c1 * s23],
        ]
    )


def chain(joints):
    """Where the foot is in frame {0}: each link turns about its z after it is placed by a and alpha [eq. 1]."""
    pose = np.eye(4)
    for theta, (d, a, alpha) in zip((*joints, 0.0), TABLE_1, strict=True):
        along_x, along_z = np.eye(4), np.eye(4)
        along_x[:3, :3], along_x[0, 3] = Rotation.from_euler("x", alpha).as_matrix(), a
        along_z[:3, :3], along_z[2, 3] = Rotation.from_euler("z", theta).as_matrix(), d
        pose = pose @ along_x @ along_z
    return pose[:3, 3]


@pytest.mark.parametrize("joints", JOINTS)
def test_table_1_is_our_right_leg(joints):
    foot = np.empty(3)
    leg_position(joints, -1.0, LENGTHS, foot)
    np.testing.assert_allclose(BODY_FROM_DH @ chain(joints), foot, atol=1e-15)


@pytest.mark.parametrize("joints", JOINTS)
def test_eq_4_mended_is_the_left_legs_jacobian_in_the_body(joints):
    left, right = np.empty((3, 3)), np.empty((3, 3))
    leg_jacobian(joints, 1.0, LENGTHS, left)
    leg_jacobian(joints, -1.0, LENGTHS, right)
    np.testing.assert_allclose(eq_4(joints), left, atol=1e-15)
    # The right one has L1 with the other sign, in the first column alone.
    l1_terms = L1 * np.array([0, -math.sin(joints[0]), math.cos(joints[0])])
    np.testing.assert_allclose(left[:, 0] - right[:, 0], 2 * l1_terms, atol=1e-15)
    np.testing.assert_array_equal(left[:, 1:], right[:, 1:])
