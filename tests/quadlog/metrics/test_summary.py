"""Values and intervals of samples, against pandas, SciPy and draws of which the truth is known."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.signal import lfilter

from quadlog.metrics.intervals import FEWEST_IN_TIME, mean_interval_in_time, ratio_interval_in_time
from quadlog.metrics.positioning import ellipse_samples, fix_error_samples, residual_samples
from quadlog.metrics.summary import (
    Samples,
    detail_of,
    finite_samples,
    interval_of,
    metrics_of,
    value_of,
    worst_of,
)  # fmt: skip
from quadlog.positioning.ellipses import CHI2_95
from quadlog.results.text import is_alarming

S = 1_000_000_000
HZ = 20


def of(values, statistic="mean"):
    values = np.asarray(values, dtype=np.float64)
    return Samples(np.arange(len(values)) * (S // HZ), values, statistic)


@given(arrays(np.float64, st.integers(2, 40), elements=st.floats(-1e6, 1e6)))
def test_equal_to_pandas(values):
    series, squares = pd.Series(values), pd.Series(values**2)
    wanted = {"mean": series.mean(), "std": series.std(), "sum": series.sum(), "rms": squares.mean() ** 0.5}
    wanted |= {"min": series.min(), "max": series.max()}
    assert {each: value_of(of(values, each)) for each in wanted} == pytest.approx(wanted, abs=1e-6)
    quantiles = dict(zip(("p50", "p95"), series.abs().quantile([0.5, 0.95]), strict=True))
    assert detail_of(of(values)) == pytest.approx({"mean": wanted["mean"], "std": wanted["std"]} | quantiles, abs=1e-6)


def test_an_interval_keeps_to_what_can_be():
    rare = np.zeros(30 * HZ)
    rare[150] = 1
    assert interval_of(of(rare))[0] == 0
    assert interval_of(of(1 - rare))[1] == 1
    assert interval_of(of(300 * rare))[1] > 1
    assert interval_of(of(rare - 0.5))[0] < -0.5


def test_nothing_and_little():
    assert metrics_of({"eta_m": of([]), "sigma_m": of([1.0], "std")}) == {}
    one = metrics_of({"eta_m": of([2.0])})["eta_m"]
    assert (one.value, one.n, one.interval, "std" in detail_of(of([2.0]))) == (2.0, 1, None, False)
    assert finite_samples(np.arange(3), np.array([np.nan, 1, np.inf]), "mean").t_ns.tolist() == [1]


def walks(seconds: float, lasting_s: float, n: int, hz: float = HZ) -> np.ndarray:
    """(n, T) stationary AR(1) errors of deviation 1, of which neighbours share 1/e after lasting_s."""
    share = np.exp(-1 / (hz * lasting_s))
    noise = np.random.default_rng(1).normal(size=(n, round(seconds * hz)))
    noise[:, 0] /= np.sqrt(1 - share**2)
    return lfilter([np.sqrt(1 - share**2)], [1, -share], noise, axis=1)


@pytest.mark.parametrize(
    ("seconds", "lasting_s", "n", "least"),
    [
        *((30, 0.1, 60, 0.85), (30, 1.0, 60, 0.85), (60, 2.0, 60, 0.85)),
        *(
            pytest.param(seconds, lasting_s, 1000, 0.9, marks=pytest.mark.nightly)
            for seconds in (30, 60, 300)
            for lasting_s in (0.1, 0.3, 1.0, 2.0)
        ),
    ],
)
def test_every_kind_of_95_percent_interval_holds_the_truth_in_this_share_of_walks(seconds, lasting_s, n, least):
    for statistic, added, truth in (("mean", 0.5, 0.5), ("std", 0.0, 1.0), ("rms", 0.5, 1.25**0.5)):
        found = [interval_of(of(each + added, statistic)) for each in walks(seconds, lasting_s, n)]
        assert np.mean([each is not None and each[0] <= truth <= each[1] for each in found]) >= least, statistic


@pytest.mark.nightly
@pytest.mark.parametrize("lasting_s", [0.1, 1.0, 2.0])
def test_the_ratio_of_two_series_is_held_in_nine_of_ten(lasting_s):
    parts, wholes = np.exp(0.5 * walks(60, lasting_s, 500)), np.exp(0.5 * walks(60, lasting_s, 1000)[500:])
    found = [ratio_interval_in_time(a, b) for a, b in zip(parts, wholes, strict=True)]
    assert np.mean([each is not None and each[0] <= 1 <= each[1] for each in found]) >= 0.9


def test_a_series_that_is_moved_and_scaled_or_does_not_tell():
    x, noise, ones = walks(12, 0.1, 1)[0], np.random.default_rng(4).normal(size=FEWEST_IN_TIME), np.ones(40)
    low, high = mean_interval_in_time(x)
    assert mean_interval_in_time(-10 * x - 3) == pytest.approx((-10 * high - 3, -10 * low - 3))
    assert [mean_interval_in_time(each) is None for each in (noise, noise[1:], ones)] == [False, True, True]
    for seconds, kinds in ((28, "mean rms std max"), (30, "max")):
        walk = walks(seconds, 0.1, 1)[0]
        short = [kind for kind in ("mean", "rms", "std", "max") if interval_of(of(walk, kind)) is None]
        assert short == kinds.split()
    # The biases of a log are drawn once: whatever its length, it does not show how these scatter.
    long = metrics_of(dict.fromkeys(("ate_rmse_m", "eta_m"), of(walks(60, 0.1, 1)[0])))
    assert [name for name, each in long.items() if each.interval is None] == ["ate_rmse_m"]
    ratios = [ratio_interval_in_time(*each) for each in ((2 * ones, ones), (ones[:19], ones[:19]), (ones, 0 * ones))]
    assert ratios == [None, None, None]


@given(st.lists(st.tuples(st.integers(0, 10 * S), st.floats(-10, 10)), max_size=30).map(sorted), st.booleans())
def test_each_is_the_worst_of_what_is_left(rows, lowest):
    t_ns, values = np.array([t for t, _ in rows], dtype=np.int64), np.array([v for _, v in rows])
    chosen = worst_of("clearance_min_m" if lowest else "eta_m", Samples(t_ns, values, "mean"))
    badness = max([1.0, *values]) - values if lowest else np.abs(values)
    left = [i for i in range(len(rows)) if badness[i] > 0]
    for worst in chosen:
        assert badness[worst] == max(badness[i] for i in left)
        left = [i for i in left if abs(t_ns[i] - t_ns[worst]) >= S]
    assert len(chosen) == 3 or not left


def test_uwb_by_hand():
    t_ns = np.arange(3)
    samples = fix_error_samples(t_ns, np.array([[3.0, 4.0], [3.0, -4.0], [np.nan, 0.0]]))
    metrics = metrics_of(samples | residual_samples(t_ns, np.array([0.1, 0.2, np.nan]), np.array([3, 1, 4])))
    assert (metrics["uwb_rmse_m"].value, metrics["uwb_rmse_m"].n) == (5.0, 2)
    assert (metrics["uwb_bias_m"].value, metrics["uwb_bias_m"].n) == (3.0, 2)
    assert metrics["uwb_residual_m"].value == pytest.approx(np.sqrt((3 * 0.01 + 0.04) / 4))
    assert metrics["uwb_residual_m"].n == 4
    assert metrics_of(residual_samples(t_ns, np.full(3, np.nan), np.zeros(3, dtype=int))) == {}


@pytest.mark.parametrize(
    ("seconds", "lasting_s", "least"),
    [(12, 0.5, 0.98), (12, 5, 0.56), (12, 1e4, 0.35), (60, 10, 0.85), (60, 30, 0.52)],
)
def test_a_right_bound_is_seldom_called_wrong_and_a_std_claimed_at_half_is_found(seconds, lasting_s, least):
    axes = walks(seconds, lasting_s, 800, hz=2)

    def alarmed(claimed: float) -> float:
        bound_m = np.full(axes.shape[1], claimed * CHI2_95**0.5)
        logs = (metrics_of(ellipse_samples(np.arange(len(bound_m)), np.c_[x, y], bound_m))
                for x, y in zip(axes[::2], axes[1::2], strict=True))  # fmt: skip
        return np.mean([any(is_alarming(name, of) for name, of in log.items()) for log in logs])

    assert alarmed(1.0) <= 0.05
    assert alarmed(0.5) >= least
