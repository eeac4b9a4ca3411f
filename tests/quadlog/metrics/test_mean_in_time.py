"""Intervals of series, against draws of which the truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from quadlog.metrics.intervals import FEWEST_IN_TIME, mean_interval_in_time, ratio_interval_in_time
from quadlog.metrics.summary import Samples, interval_of

HZ = 20
# Statistic, what is added to a series of mean 0 and deviation 1, and the value it then has.
STATISTICS = (("mean", 0.5, 0.5), ("std", 0.0, 1.0), ("rms", 0.5, 1.25**0.5))


def walks(seconds: float, lasting_s: float, n: int) -> np.ndarray:
    """(n, T) stationary AR(1) errors, of which neighbours share 1/e after lasting_s."""
    share = np.exp(-1 / (HZ * lasting_s))
    noise = np.random.default_rng(1).normal(size=(n, round(seconds * HZ)))
    noise[:, 0] /= np.sqrt(1 - share**2)
    return lfilter([np.sqrt(1 - share**2)], [1, -share], noise, axis=1)


def held(many: np.ndarray, statistic, truth: float, hz: float = HZ) -> float:
    """The share of intervals that hold the truth."""
    t_ns = np.round(np.arange(many.shape[1]) / hz * 1e9).astype(np.int64)
    found = [interval_of(Samples(t_ns, each, statistic)) for each in many]
    return float(np.mean([each is not None and each[0] <= truth <= each[1] for each in found]))


@pytest.mark.parametrize(("seconds", "lasting_s"), [(12, 0.1), (12, 1.0), (60, 2.0)])
def test_the_truth_is_held_as_often_as_the_page_says(seconds, lasting_s):
    made = walks(seconds, lasting_s, 60)
    for statistic, added, truth in STATISTICS:
        assert held(made + added, statistic, truth) >= 0.85


@pytest.mark.nightly
@pytest.mark.parametrize("seconds", [12, 30, 60, 300])
@pytest.mark.parametrize("lasting_s", [0.1, 0.3, 1.0, 2.0])
def test_every_kind_of_interval_holds_the_truth_in_nine_of_ten(seconds, lasting_s):
    made = walks(seconds, lasting_s, 1000)
    for statistic, added, truth in STATISTICS:
        assert held(made + added, statistic, truth) >= 0.9, statistic


@pytest.mark.nightly
@pytest.mark.parametrize("lasting_s", [0.1, 1.0, 2.0])
def test_the_ratio_of_two_series_is_held_in_nine_of_ten(lasting_s):
    parts, wholes = np.exp(0.5 * walks(60, lasting_s, 500)), np.exp(0.5 * walks(60, lasting_s, 1000)[500:])
    found = [ratio_interval_in_time(a, b) for a, b in zip(parts, wholes, strict=True)]
    assert np.mean([each is not None and each[0] <= 1 <= each[1] for each in found]) >= 0.9


def test_moving_and_scaling_a_series_moves_and_scales_its_interval():
    x = walks(12, 0.1, 1)[0]
    low, high = mean_interval_in_time(x)
    assert mean_interval_in_time(10 * x - 3) == pytest.approx((10 * low - 3, 10 * high - 3))
    assert mean_interval_in_time(-x) == pytest.approx((-high, -low))


def test_none_where_a_series_does_not_tell():
    noise = np.random.default_rng(4).normal(size=FEWEST_IN_TIME)
    assert mean_interval_in_time(noise) is not None
    assert mean_interval_in_time(noise[1:]) is None
    assert mean_interval_in_time(np.ones(1000)) is None
    short_ns = np.arange(200, dtype=np.int64) * 50_000_000
    x = walks(10, 0.1, 1)[0]
    kinds = ("mean", "rms", "std", "max")
    assert [interval_of(Samples(short_ns, x, kind)) is None for kind in kinds] == [False, True, True, True]


def test_a_ratio_without_variation_is_known_and_one_without_a_whole_is_none():
    ones = np.ones(40)
    assert ratio_interval_in_time(2 * ones, ones) == (2.0, 2.0)
    assert ratio_interval_in_time(ones[:19], ones[:19]) is None
    assert ratio_interval_in_time(ones, 0 * ones) is None
