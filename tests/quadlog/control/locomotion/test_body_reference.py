import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.control.locomotion.body_reference import (
    LEASH_M,
    LEASH_RAD,
    BodyReference,
    fit_plane,
    follow,
    foothold,
    states_ahead,
)

LEVEL = np.zeros(3)
HEIGHT_M = 0.27
START_M = np.array([1.0, 2.0, HEIGHT_M])
angle = st.floats(-3.1, 3.1)


def step(reference, dt_s, wanted, position_m, yaw_rad, plane):
    follow(reference.record, dt_s, *wanted, position_m, yaw_rad, plane)


def followed(reference, seconds, dt_s, wanted, plane=LEVEL):
    """A robot that is always where it should be."""
    for _ in range(round(seconds / dt_s)):
        step(reference, dt_s, wanted, reference.position_m.copy(), float(reference.rpy[2]), plane)


@given(angle, angle, st.floats(-1, 1), st.floats(-2, 2), st.tuples(st.floats(-3, 3), st.floats(-3, 3)))
def test_wherever_the_robot_is_it_is_on_the_leash(yaw_rad, measured_rad, speed_mps, yaw_rate_radps, away_m):
    reference = BodyReference(START_M, yaw_rad, HEIGHT_M)
    measured_m = START_M + np.array([*away_m, 0])
    step(reference, 0.002, (speed_mps, yaw_rate_radps), measured_m, measured_rad, LEVEL)
    assert np.linalg.norm((reference.position_m - measured_m)[:2]) <= LEASH_M + 1e-12
    assert abs(reference.rpy[2] - measured_rad) <= LEASH_RAD + 1e-12


@given(angle, st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-1, 1))
def test_on_a_slope_it_is_parallel_to_the_plane_and_goes_along_it(yaw_rad, a, b, speed_mps):
    plane = np.array([a, b, 0.1])
    reference = BodyReference(START_M, yaw_rad, HEIGHT_M)
    followed(reference, 3.0, 0.01, (speed_mps, 0.0), plane)
    roll, pitch, yaw = reference.rpy
    up = Rotation.from_euler("ZYX", [yaw, pitch, roll]).apply([0, 0, 1])
    normal = np.array([-a, -b, 1]) / math.sqrt(a * a + b * b + 1)
    np.testing.assert_allclose(up, normal, atol=1e-6)
    assert yaw == pytest.approx(yaw_rad)
    assert reference.position_m[2] - plane @ [*reference.position_m[:2], 1] == pytest.approx(HEIGHT_M, abs=1e-6)
    velocity_mps = reference.velocity_mps
    assert np.linalg.norm(velocity_mps) == pytest.approx(abs(speed_mps))
    assert velocity_mps @ normal == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(velocity_mps[:2] * [math.sin(yaw_rad), -math.cos(yaw_rad)] @ [1, 1], 0, atol=1e-12)


@given(angle, st.sampled_from([-0.3, 0.0, 0.0, 0.2]), st.floats(-1, 1), st.floats(-1, 1))
def test_ahead_is_stepping_on(yaw_rad, slope, speed_mps, yaw_rate_radps):
    # Straight up a slope, or turning on level ground: what is ahead of a turn on a slope is not foreseen.
    if slope:
        yaw_rate_radps = 0.0
    plane = np.array([slope * math.cos(yaw_rad), slope * math.sin(yaw_rad), 0.0])
    wanted, step_s, fine = (speed_mps, yaw_rate_radps), 0.03, 60
    reference = BodyReference(START_M, yaw_rad, HEIGHT_M)
    followed(reference, 3.0, 0.01, wanted, plane)
    states = np.full((10, 12), np.nan)
    states_ahead(reference.record, step_s, states)
    for state in states:
        followed(reference, step_s, step_s / fine, wanted, plane)
        np.testing.assert_allclose(state[:3], reference.rpy, atol=1e-7)
        np.testing.assert_allclose(state[3:6], reference.position_m, atol=5e-4)
        np.testing.assert_allclose(state[6:9], [0, 0, yaw_rate_radps], atol=0)
        np.testing.assert_allclose(state[9:], reference.velocity_mps, atol=1e-9)


FOOT = np.array([0.18, 0.122, -0.27])


def landing(position, yaw, velocity, wanted, yaw_rate=0.0, until_s=0.1, stance_s=0.25, plane=LEVEL):
    foot = np.empty(3)
    vectors = (np.asarray(each, float) for each in (velocity, wanted))
    foothold(np.asarray(position, float), yaw, *vectors, yaw_rate, FOOT, until_s, stance_s, plane, foot)
    return foot


@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(-3, 3))
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
