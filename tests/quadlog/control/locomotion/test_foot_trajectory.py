from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BPoly

from quadlog.control.locomotion.gait import swing_state

START, END = np.array([0.1, -0.2, 0.03]), np.array([0.3, -0.1, 0.05])


def _state(phase: float, duration_s: float = 0.5):
    """Position, velocity and acceleration on the quintic."""
    out = np.full((3, 3), np.nan)
    swing_state(phase, duration_s, START, END, 0.06, *out)
    return out


@given(st.floats(0.01, 0.99))
def test_along_the_line_the_quintic_is_scipys(phase):
    quintic = BPoly.from_derivatives([0, 0.5], [[START[0], 0, 0], [END[0], 0, 0]])
    expected = [float(quintic(phase * 0.5, order)) for order in range(3)]
    np.testing.assert_allclose(_state(phase)[:, 0], expected, rtol=1e-9, atol=1e-9)


@given(st.floats(0.02, 0.98), st.floats(0.05, 5.0))
def test_velocity_and_acceleration_are_the_derivatives(phase, duration_s):
    step = 1e-5
    before, now, after = (_state(phase + by, duration_s) for by in (-step, 0, step))
    dt = step * duration_s
    np.testing.assert_allclose((after[0] - before[0]) / (2 * dt), now[1], atol=1e-7 / duration_s)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * dt), now[2], atol=1e-6 / duration_s**2)


@pytest.mark.parametrize("phase", [0.0, 1.0])
def test_a_foot_lifts_off_and_touches_down_without_speed_and_acceleration(phase):
    _, velocity, acceleration = _state(phase)
    np.testing.assert_allclose(velocity, 0.0, atol=1e-14)
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-12)
