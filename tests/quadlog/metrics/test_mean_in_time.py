from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from quadlog.metrics.intervals import SAFE_IN_TIME, mean_interval_in_time

WALKS = 300


def series(correlation, n, seed=0):
    """Stationary AR(1) series (WALKS, n) of mean 0."""
    noise = np.random.default_rng(seed).normal(size=(WALKS, n + 1000))
    return lfilter([1], [1, -correlation], noise)[:, 1000:]


def held(many, truth=0.0):
    """The share of intervals that hold the truth, and of series that have one."""
    found = [each for each in map(mean_interval_in_time, many) if each is not None]
    return sum(low <= truth <= high for low, high in found) / len(found), len(found) / len(many)


@pytest.mark.parametrize(("correlation", "n", "least"), [(0, 100, 0.91), (0.8, 600, 0.9), (0.95, 600, 0.87)])
def test_the_truth_is_held_as_often_as_is_said(correlation, n, least):
    share, told = held(series(correlation, n))
    assert least <= share <= 0.99
    assert told > 0.9


def test_a_quick_rhythm_does_not_hide_slow_changes():
    slow = series(0.95, 600)
    share, _ = held(slow / slow.std() + np.tile([-2.0, -1, 0, 1, 2], 120))
    assert 0.87 <= share <= 0.99


def test_independent_values_have_students_interval():
    x = np.random.default_rng(3).normal(5, 1, 4000)
    widths = np.diff([mean_interval_in_time(x), stats.t.interval(0.95, 3999, x.mean(), stats.sem(x))], axis=1)
    assert widths[0, 0] == pytest.approx(widths[1, 0], rel=0.25)
    assert np.mean(mean_interval_in_time(x)) == pytest.approx(x.mean())


def test_moving_and_scaling_a_series_moves_and_scales_its_interval():
    x = series(0.5, 230)[0]
    low, high = mean_interval_in_time(x)
    assert mean_interval_in_time(10 * x - 3) == pytest.approx((10 * low - 3, 10 * high - 3))
    assert mean_interval_in_time(-x) == pytest.approx((-high, -low))


@pytest.mark.parametrize("x", [np.ones(1000), np.arange(1000.0), np.array([]), np.arange(SAFE_IN_TIME - 1) % 2])
def test_none_where_a_series_does_not_tell(x):
    assert mean_interval_in_time(np.asarray(x, dtype=np.float64)) is None


def test_a_short_series_tells_nothing():
    noise = np.random.default_rng(4).normal(size=SAFE_IN_TIME)
    assert mean_interval_in_time(noise) is not None
    assert mean_interval_in_time(noise[1:]) is None


def test_what_the_blocks_average_out_is_no_error():
    # Blocks all alike have no variance of their own, and nothing is known of how they could have differed.
    assert mean_interval_in_time(np.tile([0.0, 1.0], 400)) is None
