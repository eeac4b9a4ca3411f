from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import cumulative_trapezoid

from quadlog.geometry import wrap_angle
from quadlog.positioning.heading.heading import GyroHeading, align_gyro, align_gyro_causally, integrate_yaw_rate
from quadlog.positioning.motion import Track

START_NS = 1_700_000_000_000_000_000


def walk(n: int = 1200, noise_mps: float = 0.05, seed: int = 0, straight: bool = False):
    """Two minutes at 0.5 m/s to and fro, its true yaw, and a gyroscope's rates."""
    rng, t_s = np.random.default_rng(seed), np.arange(n) * 0.1
    yaw = 0.3 + (0.0 if straight else 1.5) * np.sin(t_s / 4)
    velocity = 0.5 * np.stack([np.cos(yaw), np.sin(yaw)], axis=1) + noise_mps * rng.standard_normal((n, 2))
    sharp, claimed = np.tile(1e-6 * np.eye(2), (n, 1, 1)), np.tile(noise_mps**2 * np.eye(2), (n, 1, 1))
    t_ns = START_NS + np.rint(t_s * 1e9).astype(np.int64)
    track = Track(t_ns, np.cumsum(velocity, axis=0) * 0.1, velocity, sharp, claimed, np.zeros(n), np.zeros(n))
    return track, yaw, np.gradient(yaw, t_s) + 0.003 * rng.standard_normal(n)


@given(st.lists(st.tuples(st.integers(1, 10**9), st.floats(-5, 5)), max_size=40))
def test_summed_up_as_scipy_does(rows):
    t_ns = START_NS + np.cumsum(np.array([step for step, _ in rows], dtype=np.int64))
    rate = np.array([each for _, each in rows], dtype=np.float64)
    wanted = cumulative_trapezoid(rate, (t_ns - START_NS) * 1e-9, initial=0) if len(rows) else np.empty(0)
    np.testing.assert_allclose(integrate_yaw_rate(t_ns, rate), wanted, atol=1e-9)


@pytest.mark.parametrize("bias", [-0.05, 0.0, 0.02])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_bias_offset_and_sign_are_found(bias, sign):
    track, yaw, rate = walk()
    got = align_gyro(track, track.t_ns, sign * rate + bias)
    assert got.upside_down == (sign < 0)
    assert got.heading.drift_radps == pytest.approx(-sign * bias, abs=0.002)
    error = wrap_angle(got.heading.yaw_rad - yaw)
    assert np.abs(error).max() < np.radians(2)
    assert np.sqrt(np.mean((error / got.heading.yaw_std_rad) ** 2)) < 1.5


def test_a_straight_walk_tells_no_sign():
    track, _, rate = walk(straight=True)
    assert not align_gyro(track, track.t_ns, -rate).upside_down


def test_std_grows_before_and_after_the_motion_as_the_bias_is_known():
    track, yaw, rate = walk()
    velocity = track.velocity_mps.copy()
    velocity[:300] = velocity[900:] = 0
    still = Track(track.t_ns, track.position_m, velocity, *(getattr(track, each) for each in REST))
    errors, stds = [], []
    for seed in range(12):
        _, _, rate = walk(seed=seed)
        got = align_gyro(still, track.t_ns, rate + 0.02).heading
        errors.append(wrap_angle(got.yaw_rad - yaw)[[0, 600, -1]])
        stds.append(got.yaw_std_rad[[0, 600, -1]])
    middle = np.mean(stds, axis=0)[1]
    assert np.mean(stds, axis=0)[0] > 1.3 * middle
    assert np.mean(stds, axis=0)[2] > 1.3 * middle
    assert (np.sqrt(np.mean(np.square(errors), axis=0)) < 1.5 * np.mean(stds, axis=0)).all()


REST = ("covariance_m2", "velocity_covariance_m2ps2", "z_m", "z_std_m")


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_causal_gyro_finds_the_same_in_the_end_and_knows_nothing_beforehand(sign):
    track, yaw, rate = walk(600)
    got = align_gyro_causally(track, track.t_ns, sign * rate + 0.02)
    assert np.abs(wrap_angle(got.yaw_rad - yaw))[300:].max() < np.radians(4)
    part = Track(*(getattr(track, each)[:300] for each in ("t_ns", "position_m", "velocity_mps", *REST)))
    before = align_gyro_causally(part, track.t_ns[:300], (sign * rate + 0.02)[:300])
    np.testing.assert_array_equal(before.yaw_rad, got.yaw_rad[:300])
    np.testing.assert_array_equal(before.yaw_std_rad, got.yaw_std_rad[:300])
    assert not got.told[0]


def test_without_rates_nothing_is_told():
    track, _, _ = walk(20)
    none = np.empty(0, dtype=np.int64), np.empty(0)
    got = align_gyro(track, *none)
    assert isinstance(got, GyroHeading)
    assert not got.heading.told
    assert not align_gyro_causally(track, *none).told.any()
