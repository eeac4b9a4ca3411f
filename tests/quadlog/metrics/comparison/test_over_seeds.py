"""Intervals over seeds and the best of several settings, held to SciPy's t-tests."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from quadlog.metrics.comparison.over_seeds import clear_best, over_seeds


@given(st.integers(0, 10**6), st.integers(2, 5), st.integers(2, 8), st.booleans())
def test_the_best_is_what_paired_t_tests_with_bonferroni_say(seed, settings, seeds, lower):
    rng = np.random.default_rng(seed)
    values = rng.normal(rng.normal(0, 2, (settings, 1)), 1, (settings, seeds)) + rng.normal(0, 3, seeds)
    means = values.mean(axis=1)
    leader = int(np.argmin(means) if lower else np.argmax(means))
    others = [stats.ttest_rel(values[leader], values[each]).pvalue for each in range(settings) if each != leader]
    assert clear_best(values, lower=lower) == (leader if max(others) < 0.05 / len(others) else None)


@pytest.mark.parametrize(
    "values",
    [
        [[1.0], [2.0]],  # one seed
        [[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]],  # the seed changes nothing
        [[1.0, 1.1, 1.2], [2.0, 2.1, 2.2]],  # nor the difference
        [[1.0, 1.1, math.nan], [9.0, 9.3, 9.1]],  # a run that failed
        [[1.0, 1.1, 1.3]],
    ],
)
def test_nothing_is_best_without_evidence(values):
    assert clear_best(np.array(values), lower=True) is None


def test_a_setting_to_which_a_metric_does_not_apply_is_no_rival():
    values = np.array([[1.0, 1.2, 1.1], [math.nan] * 3, [9.0, 9.3, 9.1]])
    assert clear_best(values, lower=True) == 0
    assert clear_best(values, lower=False) == 2


@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=9).filter(lambda values: np.ptp(values) > 1e-3))
def test_the_interval_is_students(values):
    mean, low, high = over_seeds(np.array([*values, math.nan]))
    expected = stats.t.interval(0.95, len(values) - 1, np.mean(values), stats.sem(values))
    assert (mean, low, high) == pytest.approx((np.mean(values), *expected), rel=1e-9, abs=1e-6)


def test_equal_values_have_no_interval():
    assert over_seeds(np.array([2.0, 2.0, 2.0])) == (2.0, None, None)
    assert math.isnan(over_seeds(np.array([math.nan])).mean)
