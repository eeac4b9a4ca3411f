"""Paired differences, against draws of which the truth is known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import signal, stats

from quadlog.metrics.comparison.paired import paired_differences
from quadlog.metrics.summary import Samples, Statistic

N = 2000
DRAWS = 80
STATISTICS: dict[str, tuple[Statistic, Any]] = {
    "eta_m": ("mean", np.mean),
    "cross_track_rmse_m": ("rms", lambda x: np.sqrt(np.mean(x**2))),
    "sigma_m": ("std", lambda x: np.std(x, ddof=1)),
}


def series(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Two runs that have most in common at each instant, neighbours alike, the second larger and wider."""
    rng = np.random.default_rng(seed)
    noise = signal.lfilter([np.sqrt(1 - 0.8**2)], [1, -0.8], rng.normal(size=(3, N + 100)), axis=1)[:, 100:]
    common = 0.5 + 0.3 * noise[0]
    return common + 0.05 * noise[1], 1.05 * common + 0.02 + 0.05 * noise[2]


@pytest.mark.parametrize("name", STATISTICS)
def test_intervals_hold_the_true_difference_and_are_no_wider_than_chance(name: str) -> None:
    statistic, value = STATISTICS[name]
    mean = np.array([0.5, 1.05 * 0.5 + 0.02])
    variance = np.array([0.3**2, (1.05 * 0.3) ** 2]) + 0.05**2
    truth = np.diff({"mean": mean, "rms": np.sqrt(mean**2 + variance), "std": np.sqrt(variance)}[statistic])[0]
    t_ns = np.arange(N, dtype=np.int64)
    differences, intervals = [], []
    for seed in range(DRAWS):
        a, b = series(seed)
        found = paired_differences({name: Samples(t_ns, a, statistic)}, {name: Samples(t_ns, b, statistic)})[name]
        assert found.difference == pytest.approx(value(b) - value(a))
        assert found.pairs == N
        differences.append(found.difference)
        intervals.append((np.nan, np.nan) if found.interval is None else found.interval)
    low, high = np.array(intervals).T
    assert np.isfinite(low).mean() > 0.95
    assert np.mean((low <= truth) & (truth <= high)) > 0.88
    by_chance = 2 * stats.norm.ppf(0.975) * np.std(differences)
    assert 0.9 * by_chance < np.nanmedian(high - low) < 1.6 * by_chance


def test_only_common_instants_count() -> None:
    a = Samples(np.arange(0, 300, dtype=np.int64), np.arange(300.0), "mean")
    b = Samples(np.arange(100, 420, 2, dtype=np.int64), np.arange(160.0), "mean")
    found = paired_differences({"eta_m": a}, {"eta_m": b})["eta_m"]
    assert (found.pairs, found.alone_a, found.alone_b) == (100, 200, 60)
    assert found.difference == pytest.approx(np.mean(np.arange(100.0)) - np.mean(np.arange(100.0, 300.0, 2)))
    late = Samples(b.t_ns + 1001, b.values, "mean")
    assert paired_differences({"eta_m": a}, {"eta_m": late}) == {}


@pytest.mark.parametrize(
    ("name", "statistic"), [("collisions", "sum"), ("expanded_total", "sum"), ("fallen", "max"), ("max_error_m", "max")]
)
def test_counts_and_extremes_have_no_interval(name: str, statistic: Statistic) -> None:
    a, b = (np.abs(each) for each in series(4))
    t_ns = np.arange(N, dtype=np.int64)
    found = paired_differences({name: Samples(t_ns, a, statistic)}, {name: Samples(t_ns, b, statistic)})[name]
    assert (found.interval, found.clear) == (None, False)
    assert found.difference == pytest.approx((b.sum() - a.sum()) if statistic == "sum" else b.max() - a.max())


def test_what_is_read_with_many_others_must_be_clearer() -> None:
    a, b = series(5)
    t_ns = np.arange(N, dtype=np.int64)
    alone = paired_differences({"eta_m": Samples(t_ns, a, "mean")}, {"eta_m": Samples(t_ns, b, "mean")})["eta_m"]
    assert alone.interval is not None
    assert alone.clear
    b = b - alone.interval[0] + 1e-6  # 95 % sure by a hair
    one, other = Samples(t_ns, a, "mean"), Samples(t_ns, b, "mean")
    assert paired_differences({"eta_m": one}, {"eta_m": other})["eta_m"].clear
    names = ("eta_m", "eta_time_m", "plan_error_m")
    among = paired_differences(dict.fromkeys(names, one), dict.fromkeys(names, other))
    assert not any(each.clear for each in among.values())
    assert all(each.interval is not None and each.interval[0] > 0 for each in among.values())


def test_strides_are_not_paired_and_a_run_that_goes_on_is_not_the_same() -> None:
    t_ns = np.arange(20, dtype=np.int64)
    strides = {"stride_frequency_hz": Samples(np.repeat(t_ns, 2), np.full(40, 2.0), "mean")}
    assert paired_differences(strides, strides) == {}
    touched = np.zeros(20)
    touched[15] = 1.0
    a, b = Samples(t_ns[:10], touched[:10], "sum"), Samples(t_ns, touched, "sum")
    assert not paired_differences({"collisions": a}, {"collisions": b})["collisions"].same
    assert paired_differences({"collisions": b}, {"collisions": b})["collisions"].same
