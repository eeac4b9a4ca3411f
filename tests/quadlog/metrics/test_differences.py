"""Paired differences, against draws of which the truth is known; over seeds, against SciPy's t-tests."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal, stats

from quadlog.metrics.differences import PairedDifference, clear_best, over_runs, paired_differences
from quadlog.metrics.summary import Samples, Statistic, value_of

N = 2000
DRAWS = 80
T_NS = np.arange(N, dtype=np.int64)


def series(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Two runs that have most in common at each instant, neighbours alike, the second larger and wider."""
    rng = np.random.default_rng(seed)
    noise = signal.lfilter([np.sqrt(1 - 0.8**2)], [1, -0.8], rng.normal(size=(3, N + 100)), axis=1)[:, 100:]
    common = 0.5 + 0.3 * noise[0]
    return common + 0.05 * noise[1], 1.05 * common + 0.02 + 0.05 * noise[2]


@pytest.mark.parametrize(("name", "statistic"), [("eta_m", "mean"), ("cross_track_rmse_m", "rms"), ("sigma_m", "std")])
def test_intervals_hold_the_true_difference_and_are_no_wider_than_chance(name: str, statistic: Statistic) -> None:
    mean = np.array([0.5, 1.05 * 0.5 + 0.02])
    variance = np.array([0.3**2, (1.05 * 0.3) ** 2]) + 0.05**2
    truth = np.diff({"mean": mean, "rms": np.sqrt(mean**2 + variance), "std": np.sqrt(variance)}[statistic])[0]
    differences, intervals = [], []
    for seed in range(DRAWS):
        a, b = (Samples(T_NS, each, statistic) for each in series(seed))
        found = difference(name, a, b)
        assert found.difference == pytest.approx(value_of(b) - value_of(a))
        differences.append(found.difference)
        intervals.append((np.nan, np.nan) if found.interval is None else found.interval)
    low, high = np.array(intervals).T
    assert np.isfinite(low).mean() > 0.95
    assert np.mean((low <= truth) & (truth <= high)) > 0.88
    by_chance = 2 * stats.norm.ppf(0.975) * np.std(differences)
    assert 0.9 * by_chance < np.nanmedian(high - low) < 1.6 * by_chance


def difference(name: str, a: Samples, b: Samples) -> PairedDifference:
    return paired_differences({name: a}, {name: b})[name]


def test_only_common_instants_count_and_a_run_that_goes_on_is_not_the_same() -> None:
    a = Samples(T_NS[:300], np.arange(300.0), "mean")
    b = Samples(T_NS[100:420:2], np.arange(160.0), "mean")
    found = difference("eta_m", a, b)
    assert found.difference == pytest.approx(np.mean(np.arange(100.0)) - np.mean(np.arange(100.0, 300.0, 2)))
    assert paired_differences({"eta_m": a}, {"eta_m": replace(b, t_ns=b.t_ns + 1001)}) == {}
    shorter = replace(a, t_ns=T_NS[:99], values=a.values[:99])
    assert (difference("eta_m", a, a).same, difference("eta_m", a, shorter).same) == (True, False)
    for name, statistic in (("collisions", "sum"), ("max_error_m", "max")):
        found = difference(name, replace(a, statistic=statistic), replace(b, statistic=statistic))
        assert (found.interval, found.clear) == (None, False)
    # Each run has its strides at instants of its own.
    assert paired_differences({"stride_frequency_hz": a}, {"stride_frequency_hz": a}) == {}


def test_what_is_read_with_many_others_must_be_clearer() -> None:
    a, b = series(5)
    one, alone = Samples(T_NS, a, "mean"), difference("eta_m", Samples(T_NS, a, "mean"), Samples(T_NS, b, "mean"))
    assert alone.interval is not None
    other = Samples(T_NS, b - alone.interval[0] + 1e-6, "mean")  # 95 % sure by a hair
    assert difference("eta_m", one, other).clear
    names = ("eta_m", "eta_time_m", "plan_error_m")
    among = paired_differences(dict.fromkeys(names, one), dict.fromkeys(names, other))
    assert not any(each.clear for each in among.values())
    assert all(each.interval is not None and each.interval[0] > 0 for each in among.values())


@given(st.integers(0, 10**6), st.integers(2, 5), st.integers(2, 8), st.booleans())
def test_the_best_is_what_paired_t_tests_with_bonferroni_say(seed, settings, seeds, lower):
    rng = np.random.default_rng(seed)
    values = rng.normal(rng.normal(0, 2, (settings, 1)), 1, (settings, seeds)) + rng.normal(0, 3, seeds)
    means = values.mean(axis=1)
    leader = int(np.argmin(means) if lower else np.argmax(means))
    others = [stats.ttest_rel(values[leader], values[each]).pvalue for each in range(settings) if each != leader]
    assert clear_best(values, lower=lower) == (leader if max(others) < 0.05 / len(others) else None)


@pytest.mark.parametrize(
    ("values", "best"),
    [
        ([[1.0], [2.0]], None),
        ([[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]], None),  # the seed changes nothing
        ([[1.0, 1.1, 1.2], [2.0, 2.1, 2.2]], None),  # nor the difference
        ([[1.0, 1.1, math.nan], [9.0, 9.3, 9.1]], None),  # a run that failed
        ([[1.0, 1.1, 1.3]], None),
        ([[1.0, 1.2, 1.1], [math.nan] * 3, [9.0, 9.3, 9.1]], 0),  # to the second it does not apply
    ],
)
def test_nothing_is_best_without_evidence(values, best):
    assert clear_best(np.array(values), lower=True) == best


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=30), st.lists(st.integers(0, 1), min_size=2, max_size=60))
def test_intervals_over_runs_are_students_and_those_of_falls_wilsons(x, falls):
    found = over_runs(np.array([*x, math.nan]))
    assert (found.mean, found.runs) == (pytest.approx(np.mean(x), abs=1e-9), len(x))
    if np.ptp(x) > 1e-6:
        expected = stats.t.interval(0.95, len(x) - 1, np.mean(x), stats.sem(x))
        assert found.interval == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert over_runs(np.array(x), "count").interval is None
    wilsons = stats.binomtest(sum(falls), len(falls)).proportion_ci(0.95, method="wilson")
    interval = over_runs(np.array(falls, float), "yes or no").interval
    assert interval == pytest.approx((wilsons.low, wilsons.high), abs=1e-12)


def test_one_run_and_runs_all_alike_have_no_interval_over_runs():
    assert over_runs(np.full(7, 0.1)) == (0.1, None, 7)
    assert over_runs(np.ones(1), "yes or no") == over_runs(np.array([1.0, math.nan])) == (1.0, None, 1)
    assert math.isnan(over_runs(np.array([math.nan])).mean)
