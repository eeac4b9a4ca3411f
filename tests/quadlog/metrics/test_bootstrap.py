from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from quadlog.metrics import intervals as bootstrap
from quadlog.metrics.intervals import (
    block_length,
    corrected_confidence,
    fewest_values,
    median_interval,
    median_interval_in_time,
    pooled_median_interval,
    ratio_interval_in_time,
)


def test_the_medians_interval_is_scipys() -> None:
    values = np.random.default_rng(1).lognormal(1.5, 0.5, 60)
    theirs = stats.bootstrap(
        (values,), np.median, method="percentile", n_resamples=20_000, rng=np.random.default_rng(2), vectorized=True
    ).confidence_interval
    ours = median_interval(values, np.random.default_rng(3))
    assert_allclose(ours, theirs, rtol=0.03)


@pytest.mark.parametrize("n", [9, 15, 41])
def test_the_bounds_are_the_order_statistics_that_the_binomial_law_names(n: int) -> None:
    """P(median of a resample <= the k-th value) = P(Binomial(n, k/n) >= (n+1)/2), for odd n."""
    law = stats.binom.sf((n + 1) // 2 - 1, n, np.arange(1, n + 1) / n)
    interval = median_interval(np.arange(1.0, n + 1), np.random.default_rng(0))
    assert interval is not None
    # Where the law passes close to a bound, 2000 resamples may take the neighbour.
    for value, share in zip(interval, (0.025, 0.975), strict=True):
        low, high = np.searchsorted(law, [share - 0.012, share + 0.012]) + 1
        assert low <= value <= high


def test_few_values_give_their_range_and_one_gives_nothing() -> None:
    assert median_interval(np.array([2.0, 5.0, 3.0]), np.random.default_rng(0)) == (2.0, 5.0)
    assert median_interval(np.array([2.0]), np.random.default_rng(0)) is None
    assert median_interval(np.empty(0), np.random.default_rng(0)) is None


def test_many_values_are_drawn_in_portions(monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(1).normal(size=500)
    at_once = median_interval(values, np.random.default_rng(5))
    monkeypatch.setattr(bootstrap, "_MAX_DRAWN", 4321)
    assert median_interval(values, np.random.default_rng(5)) == at_once


@pytest.mark.parametrize("n", [21, 230])
def test_blocks_in_time_are_those_of_a_plain_loop(monkeypatch: pytest.MonkeyPatch, n: int) -> None:
    """21 values are five blocks of five, of which the last is cut to one."""
    monkeypatch.setattr(bootstrap, "RESAMPLES", 20_000)
    draw = np.random.default_rng(4)
    level = np.exp(np.convolve(draw.normal(size=n + 19), np.ones(20) / 4, "valid"))
    parts, wholes = (1000 * level).astype(int), (200 * level**0.5 * draw.lognormal(0, 0.4, n)).astype(int)
    length, ratios = block_length(n), []
    for _ in range(20_000):
        first = draw.integers(n - length + 1, size=n // length + 1)
        index = (first[:, None] + np.arange(length)).ravel()[:n]
        ratios.append(parts[index].sum() / wholes[index].sum())
    ours = ratio_interval_in_time(parts, wholes, np.random.default_rng(0))
    theirs = np.percentile(ratios, [2.5, 97.5])
    assert_allclose(ours, theirs, atol=0.02 * (theirs[1] - theirs[0]))


def test_neighbours_that_are_alike_widen_the_interval() -> None:
    """The same values in the order of time and shuffled: only the order differs."""
    draw = np.random.default_rng(6)
    wholes = np.repeat(draw.integers(10, 1000, 40), 25)
    shuffled = draw.permutation(wholes)
    together, apart = (
        ratio_interval_in_time(np.full(1000, 500), each, np.random.default_rng(0)) for each in (wholes, shuffled)
    )
    assert together is not None
    assert apart is not None
    assert together[1] - together[0] > 3 * (apart[1] - apart[0])


def test_too_few_in_time_or_a_bound_at_infinity_is_no_interval() -> None:
    ones = np.ones(40, dtype=np.int64)
    assert ratio_interval_in_time(ones[:19], ones[:19], np.random.default_rng(0)) is None
    assert ratio_interval_in_time(ones[:20], ones[:20], np.random.default_rng(0)) == (1.0, 1.0)
    rarely = np.eye(1, 40, 7, dtype=np.int64)[0]
    assert ratio_interval_in_time(ones, rarely, np.random.default_rng(0)) is None


def test_a_block_is_the_root_of_the_series() -> None:
    assert [block_length(n) for n in (1, 20, 100, 230, 10_000)] == [1, 4, 10, 15, 100]


def test_the_median_of_groups_agrees_with_scipy_where_every_group_is_one_value() -> None:
    values = np.random.default_rng(7).exponential(10, 201)
    ours = pooled_median_interval(values, np.arange(201), np.random.default_rng(0))
    theirs = stats.bootstrap(
        (values,), np.median, method="percentile", rng=np.random.default_rng(1)
    ).confidence_interval
    assert_allclose(ours, (theirs.low, theirs.high), rtol=0.03)
    assert pooled_median_interval(values, np.arange(201) % 5, np.random.default_rng(0)) is None


def test_values_that_come_in_groups_widen_the_interval_of_their_median() -> None:
    draw = np.random.default_rng(8)
    group = np.repeat(np.arange(40), 25)
    values = draw.normal(0, 1, 40)[group] + draw.normal(0, 0.1, 1000)
    wide = pooled_median_interval(values, group, np.random.default_rng(0))
    narrow = pooled_median_interval(values, np.arange(1000), np.random.default_rng(0))
    in_time = median_interval_in_time(values, np.random.default_rng(0))
    assert wide is not None
    assert narrow is not None
    assert in_time is not None
    for each in (wide, in_time):
        assert each[1] - each[0] > 2 * (narrow[1] - narrow[0])
        assert each[0] <= np.median(values) <= each[1]


def test_the_range_of_the_fewest_values_holds_the_median_as_often_as_asked() -> None:
    assert [fewest_values(corrected_confidence(k)) for k in (1, 2, 10)] == [6, 7, 9]
    for comparisons in range(1, 30):
        confidence = corrected_confidence(comparisons)
        n = fewest_values(confidence)
        assert 1 - 2.0 ** (1 - n) >= confidence - 1e-12 > 1 - 2.0 ** (2 - n)
