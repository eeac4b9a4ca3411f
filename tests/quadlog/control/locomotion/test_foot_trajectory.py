from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_bvp

from quadlog.control.locomotion.foot_trajectory import (
    EASED,
    PARABOLA,
    FootCycle,
    foot_curve_state,
    lateral_peak_m,
    swing_state,
)

T, S, H, LAM = 1.0, 0.04, 0.02, 0.5
POWERS = (PARABOLA, 2, EASED, 4)


def _state(phase: float, power: int = EASED, duration_s: float = 0.5, aside=(0.0, 0.01, 0.0)):
    start, end = np.array([0.1, -0.2, 0.03]), np.array([0.3, -0.1, 0.05])
    out = np.full((3, 3), np.nan)
    foot_curve_state(phase, duration_s, start, end, 0.06, np.array(aside), power, *out)
    return out


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
    position, _, _ = cycle.at(swing)
    np.testing.assert_allclose(position, np.column_stack([x - S / 2, 0 * x, z]), atol=1e-15)
    stance = np.linspace(lam * T, T, 200, endpoint=False)
    position, _, _ = cycle.at(stance)
    x = _printed_stance(stance, lam)
    np.testing.assert_allclose(position, np.column_stack([x - S / 2, 0 * x, 0 * x]), atol=1e-15)


def test_the_cycle_repeats():
    cycle, t_s = FootCycle(0.8, S, H, aside_m=0.01), np.linspace(0, 0.79, 57)
    for once, later in zip(cycle.at(t_s), cycle.at(t_s + 1.6), strict=True):
        np.testing.assert_allclose(once, later, atol=1e-12)


@given(
    st.floats(0.02, 0.98).filter(lambda s: abs(s - 0.5) > 1e-3),
    st.sampled_from(POWERS),
    st.floats(0.05, 5.0),
)
def test_velocity_and_acceleration_are_the_derivatives(phase, power, duration_s):
    step = 1e-5
    before, now, after = (_state(phase + by, power, duration_s) for by in (-step, 0, step))
    dt = step * duration_s
    np.testing.assert_allclose((after[0] - before[0]) / (2 * dt), now[1], atol=1e-7 / duration_s)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * dt), now[2], atol=1e-6 / duration_s**2)


@pytest.mark.parametrize("power", [EASED, 4])
@pytest.mark.parametrize("phase", [0.0, 1.0])
def test_a_foot_lifts_off_and_touches_down_without_speed_and_acceleration(power, phase):
    _, velocity, acceleration = _state(phase, power)
    np.testing.assert_allclose(velocity, 0.0, atol=1e-14)
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-12)


@pytest.mark.parametrize("t_s", [0.0, 0.5])
def test_as_printed_the_bulge_alone_does_not(t_s):
    """Y(t) leaves the ground, and meets it, at M T / (8 k J1)."""
    moment, k, inertia = 0.7, 175.0, 0.0063
    cycle = FootCycle(T, S, H, aside_m=lateral_peak_m(moment, k, inertia, T))
    # Amid t < lambda T and at its end: of the swing, hence just before.
    (velocity,), (acceleration,) = (each for each in cycle.at(np.array([max(t_s - 1e-12, 0.0)]))[1:])
    np.testing.assert_allclose(velocity[[0, 2]], 0.0, atol=1e-9)
    np.testing.assert_allclose(acceleration[[0, 2]], 0.0, atol=1e-9)
    assert velocity[1] == pytest.approx(-moment * T / (8 * k * inertia) * (1 if t_s == 0 else -1))
    assert acceleration[1] == pytest.approx(moment / (2 * k * inertia))


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
    np.testing.assert_allclose(cycle.at(t_s)[0][:, 1], solved.sol(t_s)[0], atol=1e-12)
    assert lateral_peak_m(moment, k, inertia, period_s) == pytest.approx(solved.sol(period_s / 4)[0])


@pytest.mark.parametrize("power", POWERS)
def test_the_middle_is_highest_and_farthest_aside(power):
    start, end = np.array([0.1, -0.2, 0.03]), np.array([0.3, -0.1, 0.05])
    middle = _state(0.5, power)[0]
    np.testing.assert_allclose(middle, (start + end) / 2 + [0.0, 0.01, 0.06], atol=1e-15)


@given(st.floats(-3, 4), st.sampled_from(POWERS))
def test_a_foot_stays_within_its_swing_and_rests_outside(phase, power):
    position, velocity, acceleration = _state(phase, power)
    assert np.isfinite([position, velocity, acceleration]).all()
    assert 0.1 - 1e-12 <= position[0] <= 0.3 + 1e-12
    if not 0 <= phase <= 1:
        np.testing.assert_array_equal(position, _state(0.0 if phase < 0 else 1.0, power)[0])
        assert not velocity.any()
        assert not acceleration.any()


@pytest.mark.parametrize("phase", [0.0, 0.5, 1.0])
def test_a_controller_that_takes_one_swing_takes_the_other(phase):
    """The same ends, the same height in the middle, and the same rest as the quintic that legs swing by."""
    start, end = np.array([0.1, -0.2, 0.03]), np.array([0.3, -0.1, 0.05])
    quintic, curve = np.empty((3, 3)), np.empty((3, 3))
    swing_state(phase, 0.4, start, end, 0.06, *quintic)
    foot_curve_state(phase, 0.4, start, end, 0.06, np.zeros(3), EASED, *curve)
    np.testing.assert_allclose(curve[0], quintic[0], atol=1e-15)
    if phase != 0.5:
        np.testing.assert_allclose(curve[1:], quintic[1:], atol=1e-11)


def test_the_peak_goes_with_the_moment_and_one_over_k():
    peak = lateral_peak_m(0.5, 100.0, 0.01, 1.0)
    assert peak == pytest.approx(-0.5 / (64 * 100 * 0.01))
    assert lateral_peak_m(-0.5, 100.0, 0.01, 1.0) == -peak
    assert lateral_peak_m(0.5, 50.0, 0.01, 1.0) == pytest.approx(2 * peak)
    assert lateral_peak_m(0.5, 100.0, 0.01, 2.0) == pytest.approx(4 * peak)
    assert math.isclose(lateral_peak_m(0.5, 100.0, 0.02, 1.0), peak / 2)
