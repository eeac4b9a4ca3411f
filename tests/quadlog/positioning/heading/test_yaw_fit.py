from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.geometry import wrap_angle
from quadlog.positioning.heading.yaw_offset import CourseDifferences, SensorDrift, fit_offset

GYRO = SensorDrift(0.02, 0.0)


def line(offset_rad: float, drift_radps: float, n: int = 300, noise_rad=0.0, seed: int = 0) -> CourseDifferences:
    """Differences along a line in time, which is offset_rad at 0 s; a group every 0.2 s, with an honest weight."""
    t_s = 0.1 + 0.2 * np.arange(n)
    noise = noise_rad * np.random.default_rng(seed).standard_normal(n)
    return CourseDifferences(
        t_s, wrap_angle(offset_rad + drift_radps * t_s + noise), np.full(n, max(noise_rad, 1e-4) ** -2.0)
    )


@given(st.floats(-3.2, 3.2), st.floats(-0.07, 0.07), st.integers(60, 3000))
def test_any_line_is_found_however_often_it_goes_round(offset_rad, drift_radps, n):
    # A prior as wide as the search: the line is exact, so that the prior has no say.
    got = fit_offset(line(offset_rad, drift_radps, n), GYRO)
    t_s = np.linspace(0, 0.2 * n, 7)
    np.testing.assert_allclose(wrap_angle(got.at(t_s) - offset_rad - drift_radps * t_s), 0, atol=1e-4)


def test_a_line_in_gaussian_noise_is_that_of_least_squares():
    differences = line(0.5, 0.01, 1500, 0.1)
    got = fit_offset(differences, GYRO)
    slope, intercept = np.polyfit(
        differences.t_s, wrap_angle(differences.difference_rad - 0.01 * differences.t_s - 0.5), 1
    )
    # A mean that distrusts the far ones costs a little efficiency: a fraction of the std.
    assert got.drift_radps == pytest.approx(0.01 + slope, abs=np.sqrt(got.covariance[1, 1]))
    at_zero, std = got.at(np.zeros(1))[0], got.std_at(np.zeros(1))[0]
    assert wrap_angle(at_zero - 0.5 - intercept) == pytest.approx(0, abs=std)


def test_without_a_rate_the_offset_is_constant():
    got = fit_offset(line(0.5, 0.0, noise_rad=0.1), SensorDrift())
    np.testing.assert_array_equal(got.at(np.array([0.0, 99.0])), got.offset_rad)
    np.testing.assert_array_equal(got.std_at(np.array([0.0, 99.0])), np.sqrt(got.covariance[0, 0]))
    assert got.drift_radps == 0


@pytest.mark.parametrize("n", [60, 600])
def test_std_is_the_scatter_of_many_fits_in_the_middle_and_away_from_it(n):
    """Of white noise. The largest of several estimates counts, so it may claim more, and hardly less."""
    fits = [fit_offset(line(0.5, 0.01, n, 0.2, seed), SensorDrift(0.02)) for seed in range(200)]
    for t_s in (np.array([0.1 * n]), np.array([0.0]), np.array([0.4 * n])):
        error = np.array([wrap_angle(each.at(t_s) - 0.5 - 0.01 * t_s)[0] for each in fits])
        claimed = np.sqrt(np.mean([each.std_at(t_s)[0] ** 2 for each in fits]))
        assert 0.9 < claimed / np.sqrt(np.mean(error**2)) < 1.8


def test_std_knows_of_errors_that_last():
    """Noise that lasts four seconds: groups are not independent, and neither are seconds."""
    errors, stds = [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        differences = line(0.0, 0.0, 600)
        lasting = np.repeat(0.2 * rng.standard_normal(31), 20)[rng.integers(20) :][:600]
        got = fit_offset(
            CourseDifferences(differences.t_s, lasting + 0.02 * rng.standard_normal(600), np.full(600, 25.0)),
            SensorDrift(),
        )
        errors.append(got.offset_rad)
        stds.append(np.sqrt(got.covariance[0, 0]))
    assert 0.8 < np.mean(stds) / np.std(errors) < 1.5


def test_what_is_known_of_the_drift_beforehand_holds_where_the_log_is_short():
    """Four seconds tell no drift of 0.001 rad/s: the std beyond is that of the prior."""
    got = fit_offset(line(0.3, 0.0, 20, 0.1), SensorDrift(0.001))
    assert abs(got.drift_radps) < 0.0005
    assert np.sqrt(got.covariance[1, 1]) == pytest.approx(0.001, rel=0.1)
    far = got.std_at(np.array([1000.0]))[0]
    assert far == pytest.approx(1.0, rel=0.1)


def test_few_groups_take_the_tracks_word_and_one_is_enough():
    one = CourseDifferences(np.array([3.0]), np.array([0.7]), np.array([25.0]))
    got = fit_offset(one, GYRO)
    assert got.offset_rad == pytest.approx(0.7)
    assert got.std_at(np.array([3.0]))[0] == pytest.approx(0.2, rel=0.01)
    far = got.std_at(np.array([13.0]))[0]
    assert far == pytest.approx(np.hypot(0.2, 10 * 0.02), rel=0.02)
    four = CourseDifferences(np.arange(4.0), np.full(4, 0.7), np.full(4, 25.0))
    # Three degrees of freedom without any scatter, and two of the claim.
    assert fit_offset(four, SensorDrift()).covariance[0, 0] == pytest.approx(0.04 / 4 * 2 / 5, rel=0.01)


def test_a_third_of_steps_backwards_turns_nothing_and_is_counted():
    differences = line(1.0, 0.005, 600, 0.1)
    turned = differences.difference_rad.copy()
    turned[200:400] = wrap_angle(turned[200:400] + np.pi)
    got = fit_offset(CourseDifferences(differences.t_s, turned, differences.weight), GYRO)
    assert wrap_angle(got.at(np.zeros(1)) - 1.0)[0] == pytest.approx(0, abs=0.03)
    assert got.askew_share == pytest.approx(1 / 3, abs=0.01)


def test_a_random_walk_stays_within_what_is_said_of_it():
    """The closed form q^2 T / 15 for what a line leaves of a random walk, by drawing walks."""
    rng, left = np.random.default_rng(0), []
    t_s = np.linspace(0, 100, 1000)
    for _ in range(400):
        walk = np.cumsum(0.01 * np.sqrt(0.1) * rng.standard_normal(1000))
        left.append(np.mean((walk - np.polyval(np.polyfit(t_s, walk, 1), t_s)) ** 2))
    differences = CourseDifferences(t_s, np.zeros(1000), np.full(1000, 1e8))
    got = fit_offset(differences, SensorDrift(0.02, walk_std=0.01))
    assert got.std_at(np.array([50.0]))[0] ** 2 == pytest.approx(np.mean(left), rel=0.15)
    # Beyond the last difference it walks on.
    grown = got.std_at(np.array([110.0]))[0] ** 2 - got.std_at(np.array([100.0]))[0] ** 2
    assert grown == pytest.approx(10 * 0.01**2, rel=0.01)


@pytest.mark.parametrize("n", [50, 100, 500])
def test_differences_all_over_the_circle_tell_nothing(n):
    told = 0
    for seed in range(100):
        random = np.random.default_rng(seed).uniform(-np.pi, np.pi, n)
        told += fit_offset(CourseDifferences(0.2 * np.arange(n), random, np.ones(n)), SensorDrift()).told
    assert told <= 5
    assert fit_offset(line(0.5, 0.0, n, 0.7), SensorDrift()).told
