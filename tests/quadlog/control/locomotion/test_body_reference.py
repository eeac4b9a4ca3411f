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
    follow,
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
