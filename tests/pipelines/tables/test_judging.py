from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from quadlog.pipelines.tables.intervals import (
    WITHIN,
    Z_95,
    bootstrap_ratio,
    bootstrap_rms,
    claim,
    claim_of_mean,
    compare,
    compare_samples,
    judge_claim,
    judge_number,
    not_comparable,
    rms_interval,
)
from quadlog.results.papers.table import Verdict


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
    ("paper", "step", "ours", "interval", "contrary", "verdict"),
    [
        (0.1, 0.1, 0.0501, None, None, "yes"),
        (0.1, 0.1, 0.049, None, None, "no"),
        (0.1, 0.1, 0.151, None, None, "no"),
        (3.55, 0.01, 3.6, None, None, "no"),
        (2.88, 0.01, 2.884, None, None, "yes"),
        # Without a contrary the interval has to be near: within a fifth of the printed number and its last digit.
        (0.1, 0.1, 0.1, (0.04, 0.16), None, "yes"),
        (0.1, 0.1, 0.16, (0.09, 0.2), None, "undecided"),
        (0.1, 0.1, 0.2, (0.151, 0.25), None, "no"),
        (280.0, 10.0, 300.0, (100.0, 500.0), None, "undecided"),
        # A ratio that is printed below 1, and an interval with and without the 1.
        (0.98, 0.01, 0.97, (0.95, 0.99), 1.0, "yes"),
        (0.98, 0.01, 0.99, (0.95, 1.03), 1.0, "undecided"),
        (0.98, 0.01, 0.95, (0.93, 0.97), 1.0, "no"),
    ],
)
def test_a_printed_number(paper, step, ours, interval, contrary, verdict):
    row = compare("a (m)", paper, step, ours, interval, note="Note.", why_not="Why.", contrary=contrary)
    assert row.reproduces == verdict
    assert row.note == ("Note. Why." if verdict == "no" else "Note.")
    assert (row.low, row.high) == (interval or (None, None))


numbers = st.floats(-1e3, 1e3)
intervals = st.tuples(numbers, numbers).map(lambda pair: tuple(sorted(pair)))


@given(numbers, st.sampled_from([1e-4, 0.01, 1.0]), intervals, st.none() | numbers)
def test_a_number_never_reproduces_unless_the_interval_holds_it_and_leaves_out_the_contrary(
    paper, step, interval, contrary
):
    low, high = interval
    verdict = judge_number(paper, step, (low + high) / 2, interval, contrary)
    holds = low <= paper + step / 2 and high >= paper - step / 2
    assert (verdict is Verdict.NO) == (not holds)
    if verdict is Verdict.YES:
        assert contrary is None or not low <= contrary <= high
        assert contrary is not None or high - low <= 2 * WITHIN * abs(paper) + step + 1e-9
    # A wider interval knows less: it never turns a refusal into a yes or a yes into a refusal.
    wider = judge_number(paper, step, (low + high) / 2, (low - 1, high + 1), contrary)
    assert {verdict, wider} != {Verdict.YES, Verdict.NO} or (verdict, wider) == (Verdict.NO, Verdict.YES)


@given(numbers, intervals, st.booleans())
def test_a_claim_holds_where_all_of_the_interval_does(threshold, interval, above):
    low, high = interval
    verdict = judge_claim(threshold, (low + high) / 2, interval, above=above)
    inside = [low > threshold, high > threshold] if above else [high < threshold, low < threshold]
    assert verdict is {(True, True): Verdict.YES, (False, False): Verdict.NO}.get(tuple(inside), Verdict.UNDECIDED)
    # It mirrors.
    assert verdict is judge_claim(-threshold, -(low + high) / 2, (-high, -low), above=not above)


def test_what_is_not_drawn_is_judged_as_it_is():
    assert judge_claim(5.0, 5.1, None) is Verdict.YES
    assert judge_claim(5.0, 5.0, None) is Verdict.NO
    assert claim("a (1)", 5.0, 5.1, paper=5.0).paper == 5.0
    assert not_comparable("a (1)", 2.0, 1.0, why="Why.").note == "Why."


def samples(centre: float, count: int, seed: int, spread: float = 0.05) -> np.ndarray:
    return np.random.default_rng(seed).normal(centre, spread, count)


@pytest.mark.parametrize(
    ("printed", "ours", "verdict"),
    [
        (samples(0.9, 10, 1), samples(0.9, 40, 2), "yes"),
        (samples(0.9, 10, 1), samples(0.8, 40, 2), "no"),
        (samples(0.9, 10, 1), samples(1.1, 40, 2), "no"),
        # The printed runs scatter so much that ours may be theirs, but ours cannot be told from 1.
        (samples(0.97, 10, 1, 0.2), samples(1.0, 40, 2, 0.2), "undecided"),
        (samples(0.9, 10, 1), samples(0.9, 5, 2), "undecided"),
        # The printed runs scatter more than ours: theirs may be ours, but our interval does not hold it.
        (np.linspace(0.5, 1.26, 10), np.linspace(0.84, 0.86, 40), "undecided"),
    ],
)
def test_printed_runs_scatter_as_ours_do(printed, ours, verdict):
    row = compare_samples("a (1)", printed, ours, np.mean, np.random.default_rng(0), 1.0)
    assert (row.paper, row.ours) == (printed.mean(), ours.mean())
    assert row.reproduces == verdict
    assert row.low < row.ours < row.high


def test_samples_of_one_kind_are_told_apart_as_rarely_as_asked():
    apart = sum(
        compare_samples("a", samples(0.9, 10, s), samples(0.9, 40, 1000 + s), np.mean, np.random.default_rng(s), 1.0)
        .reproduces
        is Verdict.NO
        for s in range(200)
    )  # fmt: skip
    assert apart <= stats.binom.ppf(0.999, 200, 0.09)  # ten runs make a bootstrap interval a little narrow


def test_a_claim_of_runs_needs_enough_of_them_and_some_that_differ():
    rng = np.random.default_rng(0)
    assert claim_of_mean("a", 0.0, np.full(6, -1.0), rng, above=False).reproduces is Verdict.YES
    assert claim_of_mean("a", 0.0, np.full(5, -1.0), rng, above=False).reproduces is Verdict.UNDECIDED
    assert claim_of_mean("a", 0.0, np.zeros(40), rng, above=False).reproduces is Verdict.UNDECIDED
    assert claim_of_mean("a", 0.0, np.ones(40), rng, above=False).reproduces is Verdict.NO


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
