import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.body_reference import fit_plane, foothold

LEVEL = np.zeros(3)
FOOT = np.array([0.18, 0.122, -0.27])
speed = st.floats(-1.5, 1.5)


def landing(position, yaw, velocity, wanted, yaw_rate=0.0, until_s=0.1, stance_s=0.25, plane=LEVEL):
    foot = np.empty(3)
    vectors = (np.asarray(each, float) for each in (velocity, wanted))
    foothold(np.asarray(position, float), yaw, *vectors, yaw_rate, FOOT, until_s, stance_s, plane, foot)
    return foot


@given(speed, speed, st.floats(-3, 3))
def test_in_mid_stance_the_foot_is_where_it_stands_under_a_body_that_goes_as_wanted(vx, vy, yaw):
    velocity = np.array([vx, vy, 0.0])
    foot = landing([1, 2, 0.3], yaw, velocity, velocity)
    body = np.array([1, 2, 0.3]) + velocity * (0.1 + 0.125)
    expected = body + Rotation.from_euler("z", yaw).apply(FOOT)
    np.testing.assert_allclose(foot[:2], expected[:2], atol=1e-12)
    assert foot[2] == 0


def test_in_a_turn_the_foot_is_put_into_the_turn():
    # Turning on the spot, the hip's way in half a stance is an arc; the foothold is right to first order.
    for stance_s in (0.2, 0.1, 0.05):
        foot = landing([0, 0, 0], 0.3, [0, 0, 0], [0, 0, 0], yaw_rate=0.8, until_s=0.0, stance_s=stance_s)
        turned = Rotation.from_euler("z", 0.3 + 0.8 * stance_s / 2).apply(FOOT)
        assert np.linalg.norm((foot - turned)[:2]) < (0.8 * stance_s / 2) ** 2 * math.hypot(*FOOT[:2])
        unturned = Rotation.from_euler("z", 0.3).apply(FOOT)
        assert np.linalg.norm((foot - turned)[:2]) < 0.1 * np.linalg.norm((foot - unturned)[:2])


def test_contacts_on_a_line_or_a_point_are_level_across():
    plane, along = np.empty(3), np.array([[0, 0, 0], [1, 1, 0.2], [2, 2, 0.4], [3, 3, 0.6]], float)
    fit_plane(along, plane)
    np.testing.assert_allclose(plane, [0.1, 0.1, 0.0], atol=1e-12)
    fit_plane(np.tile([1.0, 2.0, 0.3], (4, 1)), plane)
    np.testing.assert_allclose(plane, [0, 0, 0.3], atol=1e-12)
