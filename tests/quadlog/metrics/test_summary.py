from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from quadlog.metrics.summary import Samples, finite_samples, summarise

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
