from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from quadlog.pipelines.tables.intervals import (
    Z_95,
    bootstrap_ratio,
    bootstrap_rms,
    compare,
    rms_interval,
)


def test_the_interval_of_an_rms_holds_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(1000):
        rms, (low, high) = rms_interval(rng.normal(0, 0.3, 400) ** 2)
        assert low < rms < high
        held += low <= 0.3 <= high
    assert stats.binom.ppf(0.001, 1000, 0.95) <= held + 10  # normal squares are a little skewed
    assert held <= stats.binom.ppf(0.999, 1000, 0.95)


def test_the_bootstrap_agrees_with_the_analytic_interval_for_many_runs():
    squares = np.random.default_rng(1).normal(0, 0.3, 3000) ** 2
    rms, interval = bootstrap_rms(squares, np.random.default_rng(2))
    expected_rms, expected = rms_interval(squares)
    assert rms == pytest.approx(expected_rms, rel=1e-12)
    assert interval == pytest.approx(expected, rel=0.005)
    assert interval == bootstrap_rms(squares, np.random.default_rng(2))[1]


@pytest.mark.parametrize(
    ("paper", "step", "ours", "interval", "reproduces"),
    [
        (0.1, 0.1, 0.0501, None, True),
        (0.1, 0.1, 0.049, None, False),
        (0.1, 0.1, 0.151, None, False),
        (0.1, 0.1, 0.16, (0.09, 0.2), True),
        (0.1, 0.1, 0.16, (0.12, 0.2), False),
        (0.1, 0.1, 0.04, (0.01, 0.08), False),
        (3.55, 0.01, 3.6, None, False),
        (2.88, 0.01, 2.884, None, True),
    ],
)
def test_a_number_reproduces_where_both_round_alike_or_the_interval_holds_it(paper, step, ours, interval, reproduces):
    row = compare("a (m)", paper, step, ours, interval, note="Note.", why_not="Why.")
    assert row.reproduces is reproduces
    assert row.note == ("Note." if reproduces else "Note. Why.")
    assert (row.low, row.high) == (interval or (None, None))


def test_the_bootstrap_of_a_share_agrees_with_the_delta_method_for_many_runs():
    rng = np.random.default_rng(3)
    wholes = rng.integers(50, 150, 4000)
    # Larger runs have a larger share, so that the pooled share is not the mean of the shares.
    parts = rng.binomial(wholes, 0.2 + wholes / 250)
    share, (low, high) = bootstrap_ratio(parts, wholes, np.random.default_rng(4))
    assert share == parts.sum() / wholes.sum()
    std = np.std(parts - share * wholes, ddof=1) / np.sqrt(4000) / wholes.mean()
    assert (low, high) == pytest.approx((share - Z_95 * std, share + Z_95 * std), abs=0.15 * std)
    assert (low, high) == bootstrap_ratio(parts, wholes, np.random.default_rng(4))[1]


def test_a_share_of_nothing_is_zero_and_one_run_has_no_spread():
    rng = np.random.default_rng(5)
    assert bootstrap_ratio(np.zeros(3), np.zeros(3), rng) == (0.0, (0.0, 0.0))
    assert bootstrap_ratio(np.array([4.0]), np.array([8.0]), rng) == (0.5, (0.5, 0.5))
