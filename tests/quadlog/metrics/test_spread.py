from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from quadlog.metrics.summary import spread

values = st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=30)


@given(values)
def test_equal_to_scipy(x):
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


def test_few_and_all_alike():
    assert spread([]) is None
    one = spread([3.0])
    assert (one.mean, one.std, one.interval) == (3.0, None, None)
    alike = spread([0.1] * 7)
    assert (alike.mean, alike.std, alike.interval, alike.lowest) == (0.1, 0.0, None, 0)
    assert spread([1.0], kind="yes or no").interval is None
