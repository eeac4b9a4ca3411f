"""Statistics with their 95 % intervals, and the rules by which what a paper prints reproduces."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from quadlog.messages import Float
from quadlog.results.studies.papers import Verdict

Interval = tuple[float, float]
WITHIN = 0.2
"""A printed number reproduces where our whole interval lies within this share of it."""
NEGLIGIBLE = 0.1
"""Less than this share of a printed difference counts as none, however sure it is."""
RESAMPLES = 999


@dataclass(frozen=True)
class Statistic:
    """A number of N independent values, by a function with numpy's axis, and its 95 % interval.

    interval: None where the values are not enough, as too few of them, or values that are all alike.
    is_drawn: False for a single value in which nothing is drawn at random.
    """

    of: Callable[..., Any]
    interval: Callable[[Float], Interval | None]
    is_drawn: bool = True


def _alike(values: Float) -> bool:
    """But for rounding."""
    return float(np.ptp(values)) <= 1e-9 * float(np.abs(values).max())


def student(values: Float) -> Interval | None:
    """Of the mean of about normal values."""
    if len(values) < 2 or _alike(values):
        return None
    # Not stats.t.interval, which warns about what is nearly alike.
    mean, half = float(np.mean(values)), float(stats.t.ppf(0.975, len(values) - 1) * stats.sem(values))
    return mean - half, mean + half


def _student_of_sizes(values: Float) -> Interval | None:
    found = student(values)
    return None if found is None else (max(found[0], 0.0), found[1])


def _student_of_logarithms(values: Float) -> Interval | None:
    found = student(np.log(values))
    return None if found is None else (math.exp(found[0]), math.exp(min(found[1], 700.0)))


def _median_interval(values: Float) -> Interval | None:
    found = stats.quantile_test(values, q=0, p=0.5).confidence_interval()
    is_known = math.isfinite(found.low) and math.isfinite(found.high) and not _alike(values)
    return (float(found.low), float(found.high)) if is_known else None


def _wilson(values: Float) -> Interval:
    found = stats.binomtest(int(values.sum()), len(values)).proportion_ci(method="wilson")
    # Rounding would have 0 and 1 outside of their own intervals.
    return float(min(found.low, values.mean())), float(max(found.high, values.mean()))


def _geometric_mean(values: Float, axis: int = -1) -> Any:
    return np.exp(np.mean(np.log(values), axis=axis))


EXACT = Statistic(lambda values, axis=-1: np.mean(values, axis=axis), lambda _: None, is_drawn=False)
MEAN = Statistic(np.mean, student)
SIZE = Statistic(np.mean, _student_of_sizes)
"""The mean of what is never negative."""
GEOMETRIC_MEAN = Statistic(_geometric_mean, _student_of_logarithms)
MEDIAN = Statistic(np.median, _median_interval)
SHARE = Statistic(np.mean, _wilson)
"""Of ones among zeros, after Wilson."""


def share_of(holds: Callable[[Float], Any]) -> Statistic:
    """The share of values for which something holds, after Wilson."""
    return Statistic(
        lambda values, axis=-1: np.mean(holds(values), axis=axis), lambda values: _wilson(1.0 * holds(values))
    )


def extreme(runs: int, smallest: bool) -> Statistic:
    """The smallest or largest of so many runs: its mean, and 95 % of what tables of so many of our runs have."""

    def mean_extreme(values: Float, axis: int = -1) -> Any:
        rank = np.arange(values.shape[axis] + 1) / values.shape[axis]
        # The chance of each of our runs, in order, to be the extreme one of those drawn.
        chance = np.diff(1 - (1 - rank) ** runs if smallest else rank**runs)
        return np.sort(values, axis=axis) @ chance

    def of_tables(values: Float) -> Interval | None:
        drawn = values[np.random.default_rng(0).integers(len(values), size=(RESAMPLES, runs))]
        low, high = np.percentile((np.min if smallest else np.max)(drawn, axis=1), [2.5, 97.5])
        return (float(low), float(high)) if not _alike(values) else None

    return Statistic(mean_extreme, of_tables)


def chance_of_one_kind(statistic: Callable[..., Any], ours: Float, printed: Float) -> float:
    """How often a statistic of two samples (N,), (R,) that are mixed at random differs as much: a permutation test.

    Between samples of one distribution it is below 5 % in at most 5 % of the cases, whatever the distribution.
    """
    mixed = np.tile(np.concatenate([ours, printed]), (RESAMPLES + 1, 1))
    np.random.default_rng(0).permuted(mixed[1:], axis=1, out=mixed[1:])
    difference = statistic(mixed[:, : len(ours)], axis=1) - statistic(mixed[:, len(ours) :], axis=1)
    room = 1e-9 * max(1.0, float(np.abs(difference).max()))
    as_low, as_high = (float(np.mean(sign * (difference - difference[0]) >= -room)) for sign in (-1, 1))
    return 2 * min(as_low, as_high)


@dataclass(frozen=True)
class Judge:
    """What a paper prints or says of a quantity, and the rule by which values (N,) and their statistic reproduce it.

    printed: the number, None for words. said: the claim, as "> 5". why: a sentence for the note. takes_interval:
    whether it takes one to judge what is drawn.
    """

    rule: Callable[[Float, Statistic], Verdict]
    printed: float | None = None
    said: str = ""
    why: str = ""
    takes_interval: bool = True

    def verdict(self, values: Float, statistic: Statistic) -> Verdict:
        """Undecided where something is drawn and the values do not show how it scatters."""
        if self.takes_interval and statistic.is_drawn and statistic.interval(values) is None:
            return Verdict.UNDECIDED
        return self.rule(values, statistic)


def number(printed: float, digit: float) -> Judge:
    """A printed number, as far as it is printed, of a single run that scatters as ours do.

    No where it lies outside of what 95 % of single runs of ours have; yes where the interval of ours lies within WITHIN
    of it. What is not drawn has to round to it.
    """

    def rule(values: Float, statistic: Statistic) -> Verdict:
        ours, interval, half = float(statistic.of(values)), statistic.interval(values), digit / 2
        if interval is None:
            return Verdict.YES if round(ours / digit) == round(printed / digit) else Verdict.NO
        low, high = (ours + math.sqrt(1 + len(values)) * (end - ours) for end in interval)
        if not low - half <= printed <= high + half:
            return Verdict.NO
        room = half + WITHIN * abs(printed)
        is_near = printed - room <= interval[0] and interval[1] <= printed + room
        return Verdict.YES if is_near else Verdict.UNDECIDED

    return Judge(rule, printed)


def runs(of: Sequence[float], printed: float, contrary: float, said: str = "") -> Judge:
    """A statistic of printed runs (R,). contrary: what would be true if it were wrong, as 1 for a ratio.

    No where ours and theirs are of one kind in fewer than 5 % of the cases. Else yes where our interval leaves out the
    contrary, on the side of what is printed.
    """
    sign = 1 if printed > contrary else -1

    def rule(values: Float, statistic: Statistic) -> Verdict:
        if chance_of_one_kind(statistic.of, values, np.asarray(of, float)) < 0.05:
            return Verdict.NO
        ends = statistic.interval(values) or (-math.inf, math.inf)
        return Verdict.YES if min(sign * (end - contrary) for end in ends) > 0 else Verdict.UNDECIDED

    return Judge(rule, printed, said)


def beyond(
    threshold: float, *, above: bool = True, least: float | None = None, printed: float | None = None, why: str = ""
) -> Judge:
    """A claim that a quantity is more, or less, than a threshold, of all of our interval.

    least: up to where what is beyond the threshold counts as none. An interval that touches it is on neither side.
    """
    sign, limit = 1 if above else -1, threshold if least is None else least

    def rule(values: Float, statistic: Statistic) -> Verdict:
        ours, interval = float(statistic.of(values)), statistic.interval(values)
        if interval is None:
            return Verdict.YES if sign * (ours - limit) > 0 else Verdict.NO
        low, high = sorted(sign * (end - limit) for end in interval)
        return Verdict.YES if low > 0 else Verdict.NO if high < 0 else Verdict.UNDECIDED

    return Judge(rule, printed, f"{'>' if above else '<'} {threshold:g}", why)


def always(why: str = "") -> Judge:
    """A claim about every run, of values that are 1 where all of it holds: runs can refute it, and never prove it."""
    return Judge(lambda values, _: Verdict.UNDECIDED if (values == 1).all() else Verdict.NO, None, "always", why)


def rests(judge: Judge, why: str) -> Judge:
    """What ours rests on, or what holds by construction: it could contradict itself, and confirms nothing."""

    def rule(values: Float, statistic: Statistic) -> Verdict:
        is_no = judge.verdict(values, statistic) is Verdict.NO
        return Verdict.NO if is_no else Verdict.NOT_COMPARABLE

    return Judge(rule, judge.printed, judge.said, why, takes_interval=False)


def not_comparable(printed: float | None, why: str, said: str = "") -> Judge:
    """A number or claim that ours can neither confirm nor refute; why: a sentence."""
    return Judge(lambda *_: Verdict.NOT_COMPARABLE, printed, said, why, takes_interval=False)
