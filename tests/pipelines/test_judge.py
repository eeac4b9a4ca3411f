"""The verdict rules by simulation: ours drawn from the paper's own distribution, far from it, and from the contrary."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

from quadlog.pipelines.tables.judge import (
    EXACT,
    GEOMETRIC_MEAN,
    MEAN,
    MEDIAN,
    SHARE,
    SIZE,
    Judge,
    Statistic,
    always,
    beyond,
    chance_of_one_kind,
    extreme,
    not_comparable,
    number,
    rests,
    runs,
)
from quadlog.results.studies.papers import Verdict

Float = np.ndarray
DRAWS = 40
PRINTED = 9
SMALLEST, LARGEST = extreme(PRINTED, smallest=True), extreme(PRINTED, smallest=False)
STATISTICS = {"mean": MEAN, "median": MEDIAN, "smallest": SMALLEST, "largest": LARGEST}
AT_MOST_5 = stats.binom.ppf(0.999, DRAWS, 0.05) / DRAWS


def ratios(rng: np.random.Generator, count: int, shift: float = 0.0) -> Float:
    """Ratios that scatter as printed ones do, skewed, by a standard deviation of 2."""
    return 4.0 + rng.gamma(4.0, 1.0, count) + shift


def verdicts(judged: Callable[[np.random.Generator], Verdict]) -> dict[Verdict, float]:
    counts = Counter(judged(np.random.default_rng([7, number])) for number in range(DRAWS))
    return {verdict: counts[verdict] / DRAWS for verdict in Verdict}


def compared(statistic: Statistic, count: int, shift: float, contrary: float) -> Callable[..., Verdict]:
    def once(rng: np.random.Generator) -> Verdict:
        printed = ratios(rng, PRINTED)
        judge = runs(printed.tolist(), float(statistic.of(printed)), contrary)
        return judge.verdict(ratios(rng, count, shift), statistic)

    return once


@pytest.mark.parametrize("count", [9, 40])
@pytest.mark.parametrize("name", STATISTICS)
def test_runs_of_the_papers_own_kind_are_refused_as_rarely_as_asked_and_others_are_refused(name, count):
    alike = verdicts(compared(STATISTICS[name], count, 0.0, contrary=0.0))
    assert alike[Verdict.NO] <= AT_MOST_5
    assert alike[Verdict.YES] >= 0.85
    twice_the_spread = verdicts(compared(STATISTICS[name], count, 4.0, contrary=0.0))
    assert twice_the_spread[Verdict.NO] >= (0.8 if count == 40 else 0.7)  # the largest of nine says little


def test_a_share_is_compared_with_the_printed_share():
    above = (1.0,) * PRINTED
    claim = runs(above, 1.0, 0.5, "all")
    assert claim.verdict(np.array([1.0] * 8 + [0.0]), SHARE) is Verdict.YES  # Fisher p = 1
    assert claim.verdict(np.array([1.0] * 6 + [0.0] * 3), SHARE) is Verdict.UNDECIDED  # 0.5 is in its interval
    assert runs((0.0,) * 3, 0.1, 0.05).verdict(np.zeros(90), SHARE) is Verdict.UNDECIDED  # on the contrary's side
    # More walks do not make a true claim less likely to be confirmed.
    of_9, of_40 = (verdicts(lambda rng, n=n: claim.verdict(1.0 * (rng.random(n) < 0.95), SHARE)) for n in (9, 40))
    assert 0.8 < of_9[Verdict.YES] <= of_40[Verdict.YES]
    assert claim.verdict(np.ones(9), SHARE) is Verdict.YES
    assert claim.verdict(np.array([1.0] * 3 + [0.0] * 6), SHARE) is Verdict.NO
    for ours, theirs in (((8, 9), (9, 9)), ((20, 40), (9, 9)), ((3, 9), (7, 9))):
        samples = [np.array([1.0] * k + [0.0] * (n - k)) for k, n in (ours, theirs)]
        exact = stats.fisher_exact([[k, n - k] for k, n in (ours, theirs)])[1]
        assert (chance_of_one_kind(np.mean, *samples) < 0.05) == (exact < 0.05)
    assert verdicts(lambda rng: claim.verdict(1.0 * (rng.random(40) < 0.5), SHARE))[Verdict.YES] == 0


@pytest.mark.parametrize("statistic", [MEAN, SIZE, GEOMETRIC_MEAN])
def test_a_printed_run_scatters_as_ours_do(statistic):
    def printed_at(shift: float) -> Callable[..., Verdict]:
        def once(rng: np.random.Generator) -> Verdict:
            return number(rng.normal(100.0, 2.0) + shift, 0.1).verdict(rng.normal(100.0, 2.0, 10), statistic)

        return once

    alike = verdicts(printed_at(0.0))
    assert alike[Verdict.NO] <= AT_MOST_5
    assert alike[Verdict.YES] >= 0.9
    assert verdicts(printed_at(8.0))[Verdict.NO] >= 0.8


def paired(rng: np.random.Generator, count: int, mean: float) -> Float:
    """Differences of what is 0 or 1 in either of a pair."""
    return 1.0 * (rng.random(count) < 0.2 + mean) - (rng.random(count) < 0.2)


@pytest.mark.parametrize("count", [10, 40])
def test_paired_differences_without_a_difference_are_neither_yes_nor_no(count):
    less = beyond(0.0, above=False)
    found = verdicts(lambda rng: less.verdict(paired(rng, count, 0.0), MEAN))
    assert found[Verdict.NO] <= AT_MOST_5 / 2 + 0.02
    assert found[Verdict.YES] <= AT_MOST_5 / 2 + 0.02
    assert verdicts(lambda rng: less.verdict(paired(rng, 40, 0.5), MEAN))[Verdict.NO] >= 0.8


OURS = [5.5, 6.0, 6.5, 6.0, 5.8, 6.2]


@pytest.mark.parametrize(
    ("judge", "ours", "statistic", "verdict"),
    [
        (beyond(5.0), OURS, MEAN, Verdict.YES),
        (beyond(7.0), OURS, MEAN, Verdict.NO),
        (beyond(6.0), OURS, MEAN, Verdict.UNDECIDED),
        (beyond(5.0, least=6.0), OURS, MEAN, Verdict.UNDECIDED),
        (beyond(5.0, above=False), OURS, MEAN, Verdict.NO),
        (beyond(5.0), [5.1], EXACT, Verdict.YES),  # nothing is drawn
        (beyond(5.0), [5.0], EXACT, Verdict.NO),
        (beyond(0.0), [0.3], Statistic(np.mean, lambda _: (0.0, 0.6)), Verdict.UNDECIDED),
        (beyond(0.0, above=False), [0.3], Statistic(np.mean, lambda _: (0.0, 0.6)), Verdict.UNDECIDED),
        (number(0.1, 0.1), [0.0501], EXACT, Verdict.YES),  # it rounds to what is printed
        (number(0.1, 0.1), [0.049], EXACT, Verdict.NO),
        (number(280.0, 10.0), [200.0, 300.0, 400.0, 250.0], MEAN, Verdict.UNDECIDED),  # wider than a fifth
        (always(), [1.0] * 40, SHARE, Verdict.UNDECIDED),
        (always(), [1.0] * 39 + [0.0], SHARE, Verdict.NO),
        (not_comparable(1.0, "Why."), [9.0], EXACT, Verdict.NOT_COMPARABLE),
    ],
)
def test_a_claim_holds_where_all_of_the_interval_does(judge, ours, statistic, verdict):
    assert judge.verdict(np.array(ours), statistic) is verdict


@pytest.mark.parametrize("judge", [number(0.6, 0.1), beyond(0.5)])
def test_what_ours_rests_on_may_contradict_and_never_confirms(judge: Judge):
    resting = rests(judge, "Why.")
    assert resting.verdict(np.array([0.59, 0.6, 0.61]), MEAN) is Verdict.NOT_COMPARABLE
    assert resting.verdict(np.array([0.6]), MEAN) is Verdict.NOT_COMPARABLE
    assert resting.verdict(np.array([0.19, 0.2, 0.21]), MEAN) is Verdict.NO
    assert (resting.printed, resting.said, resting.why) == (judge.printed, judge.said, "Why.")
