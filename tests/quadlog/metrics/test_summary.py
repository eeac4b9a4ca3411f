from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from quadlog.metrics.summary import Samples, finite_samples, spread, summarise, worst_instants

STATISTICS = ("mean", "std", "rms", "sum", "max")


def of(values, statistic="mean", weights=None):
    values = np.asarray(values, dtype=np.float64)
    return Samples(np.arange(len(values)) * 100_000_000, values, statistic, weights)


@given(arrays(np.float64, st.integers(2, 40), elements=st.floats(-1e6, 1e6)))
def test_equal_to_pandas(values):
    series, found = pd.Series(values), summarise(of(values))
    assert found.n == series.count()
    assert found.mean == pytest.approx(series.mean(), abs=1e-9)
    assert found.std == pytest.approx(series.std(), abs=1e-6)
    assert found.p50 == pytest.approx(series.abs().quantile(0.5))
    assert found.p95 == pytest.approx(series.abs().quantile(0.95))


def test_values_by_hand():
    found = {statistic: summarise(of([3.0, -4.0, 1.0], statistic)).value for statistic in STATISTICS}
    assert found == pytest.approx(
        {"mean": 0.0, "std": 13**0.5, "rms": (26 / 3) ** 0.5, "sum": 0.0, "max": 3.0}, abs=1e-12
    )


def test_weights_are_repetitions():
    rng = np.random.default_rng(0)
    values, weights = np.abs(rng.normal(size=200)), rng.integers(1, 6, 200)
    found = summarise(of(values, "rms", weights))
    repeated = summarise(of(np.repeat(values, weights), "rms"))
    assert found.n == repeated.n == weights.sum()
    assert found.value == pytest.approx(repeated.value)
    low, high = found.interval
    assert low < found.value < high
    alike = summarise(of(values, "rms", np.full(200, 4)))
    assert alike.interval == pytest.approx(summarise(of(values, "rms")).interval)


def test_an_interval_keeps_to_what_can_be():
    rare = np.zeros(200)
    rare[150] = 1
    low, high = summarise(of(rare)).interval
    assert low == 0
    low, high = summarise(of(1 - rare)).interval
    assert high == 1
    assert summarise(of(100 * rare)).interval[1] > 1
    assert summarise(of(rare - 0.5)).interval[0] < -0.5


def test_nothing_and_little():
    assert summarise(of([])) is None
    assert summarise(of([1.0], "rms", np.array([0]))) is None
    one = summarise(of([2.0]))
    assert (one.value, one.n, one.std, one.interval) == (2.0, 1, None, None)
    assert finite_samples(np.arange(3), np.array([np.nan, 1, np.inf]), "mean").t_ns.tolist() == [1]


several = st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=30)


@given(several)
def test_a_spread_is_equal_to_scipys(x):
    found = spread(x)
    assert (found.runs, found.p50) == (len(x), pytest.approx(np.median(x)))
    assert found.mean == pytest.approx(np.mean(x), abs=1e-9)
    assert found.std == pytest.approx(np.std(x, ddof=1), abs=1e-9)
    assert (x[found.lowest], x[found.highest]) == (min(x), max(x))
    if np.ptp(x) > 1e-6:
        expected = stats.t.interval(0.95, len(x) - 1, np.mean(x), stats.sem(x))
        assert found.interval == pytest.approx(expected, rel=1e-9, abs=1e-9)


@given(st.lists(st.integers(0, 1), min_size=2, max_size=60))
def test_falls_have_wilsons_interval(falls):
    low, high = spread(falls, kind="yes or no").interval
    expected = stats.binomtest(sum(falls), len(falls)).proportion_ci(0.95, method="wilson")
    assert (low, high) == pytest.approx((expected.low, expected.high), abs=1e-12)
    assert 0 <= low <= np.mean(falls) <= high <= 1


def test_a_spread_of_few_and_all_alike():
    assert spread([]) is None
    one = spread([3.0])
    assert (one.mean, one.std, one.interval) == (3.0, None, None)
    alike = spread([0.1] * 7)
    assert (alike.mean, alike.std, alike.interval, alike.lowest) == (0.1, 0.0, None, 0)
    assert spread([1.0], kind="yes or no").interval is None


S = 1_000_000_000


@given(st.lists(st.tuples(st.integers(0, 10 * S), st.floats(0, 10)), max_size=30))
def test_each_is_the_worst_of_what_is_left(rows):
    rows = sorted(rows)
    t_ns, badness = np.array([t for t, _ in rows], dtype=np.int64), np.array([b for _, b in rows])
    chosen = worst_instants(t_ns, badness)
    left = [i for i in range(len(rows)) if badness[i] > 0]
    for worst in chosen:
        assert badness[worst] == max(badness[i] for i in left)
        left = [i for i in left if abs(t_ns[i] - t_ns[worst]) >= S]
    assert len(chosen) == 3 or not left
