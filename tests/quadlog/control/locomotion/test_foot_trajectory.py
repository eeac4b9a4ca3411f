from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_bvp
from scipy.interpolate import BPoly

from quadlog.control.locomotion.foot_trajectory import FootCycle, lateral_peak_m, swing_state

T, S, H = 1.0, 0.04, 0.02
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


def _printed_swing(t, lam):
    """Eq. 9 as printed, but for its domains."""
    u = t / (lam * T)
    x = S * (u - np.sin(2 * np.pi * u) / (2 * np.pi))
    half = np.sin(4 * np.pi * u) / (2 * np.pi)
    return x, np.where(t < lam * T / 2, H * (2 * u - half), H * (2 - 2 * u + half))


def _printed_stance(t, lam):
    """Eq. 10."""
    return S * ((T - t) / ((1 - lam) * T) + np.sin(2 * np.pi * (t - lam * T) / ((1 - lam) * T)) / (2 * np.pi))


@pytest.mark.parametrize("lam", [0.3, 0.5, 0.7])
def test_the_cycle_is_that_of_eqs_9_and_10_about_the_middle_of_the_step(lam):
    cycle = FootCycle(T, S, H, swing_share=lam)
    swing = np.linspace(0, lam * T, 200, endpoint=False)
    x, z = _printed_swing(swing, lam)
    position = cycle.at(swing)
    np.testing.assert_allclose(position, np.column_stack([x - S / 2, 0 * x, z]), atol=1e-15)
    stance = np.linspace(lam * T, T, 200, endpoint=False)
    position = cycle.at(stance)
    x = _printed_stance(stance, lam)
    np.testing.assert_allclose(position, np.column_stack([x - S / 2, 0 * x, 0 * x]), atol=1e-15)


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


def test_the_bulge_solves_eq_11():
    """2 J1 k y'' = M, y(0) = y(T/2) = 0, solved by scipy."""
    moment, k, inertia, period_s = -0.7, 120.0, 0.0063, 0.8
    t_s = np.linspace(0, period_s / 2, 50, endpoint=False)
    solved = solve_bvp(
        lambda _, y: np.vstack([y[1], np.full_like(y[0], moment / (2 * inertia * k))]),
        lambda start, end: np.array([start[0], end[0]]),
        np.array([0.0, period_s / 2]),
        np.zeros((2, 2)),
    )
    cycle = FootCycle(period_s, S, H, aside_m=lateral_peak_m(moment, k, inertia, period_s))
    np.testing.assert_allclose(cycle.at(t_s)[:, 1], solved.sol(t_s)[0], atol=1e-12)
    assert lateral_peak_m(moment, k, inertia, period_s) == pytest.approx(solved.sol(period_s / 4)[0])
