"""Intervals for what was drawn at random, and the rules by which printed numbers and claims reproduce."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from quadlog.messages import Float
from quadlog.metrics.intervals import FEWEST_VALUES, RESAMPLES, Z_95, Interval, wilson_interval
from quadlog.results.papers.table import PaperRow, Verdict

WITHIN = 0.2
"""A printed number without a contrary reproduces where all of our interval lies within this share of it."""
NEGLIGIBLE = 0.1
"""Less than this share of a printed difference counts as none, however sure it is."""


def compare(
    quantity: str,
    paper: float,
    printed_step: float,
    ours: float,
    interval: Interval | None = None,
    note: str = "",
    why_not: str = "",
    contrary: float | None = None,
) -> PaperRow:
    """A row beside a printed number, see judge_number. why_not is added to the note of a row that fails."""
    verdict = judge_number(paper, printed_step, ours, interval, contrary)
    return _judged(quantity, ours, paper, interval, verdict, note, why_not)


def claim(
    quantity: str,
    threshold: float,
    ours: float,
    interval: Interval | None = None,
    note: str = "",
    why_not: str = "",
    *,
    above: bool = True,
    paper: float | None = None,
) -> PaperRow:
    """A row beside a claim that a quantity is more, or less, than a threshold, see judge_claim.

    paper: the number with which it is printed, None for a claim in words.
    """
    verdict = judge_claim(threshold, ours, interval, above=above)
    printed = f"{'>' if above else '<'} {threshold:g}" if threshold in (0.0, paper) else ""
    return replace(_judged(quantity, ours, paper, interval, verdict, note, why_not), claim=printed)


def compare_samples(
    quantity: str,
    printed: Float,
    ours: Float,
    statistic: Callable[..., Any],
    rng: np.random.Generator,
    contrary: float,
    note: str = "",
    why_not: str = "",
) -> PaperRow:
    """A row beside a statistic of the runs (R,) that a paper prints; ours (N,), statistic: numpy's, with an axis.

    Both scatter: it fails where the 95 % bootstrap interval of their difference leaves out 0, and where ours lies on
    the other side of the contrary. It reproduces where the interval of ours holds the printed value and leaves out the
    contrary, of FEWEST_VALUES runs or more.
    """
    value, interval = bootstrap_statistic(ours, statistic, rng)
    paper = float(statistic(printed, axis=0))
    drawn = [values[rng.integers(len(values), size=(RESAMPLES, len(values)))] for values in (ours, printed)]
    low, high = np.percentile(statistic(drawn[0], axis=1) - statistic(drawn[1], axis=1), [2.5, 97.5])
    is_clear = not interval[0] <= contrary <= interval[1]
    verdict = Verdict.YES if is_clear and interval[0] <= paper <= interval[1] else Verdict.UNDECIDED
    if not low <= 0 <= high or (is_clear and (value > contrary) != (paper > contrary)):
        verdict = Verdict.NO
    if len(ours) < FEWEST_VALUES:
        verdict = Verdict.UNDECIDED
    return _judged(quantity, value, paper, interval, verdict, note, why_not)


def claim_of_mean(
    quantity: str, threshold: float, values: Float, rng: np.random.Generator, note: str = "", *, above: bool = True
) -> PaperRow:
    """A row beside a claim in words on the mean of independent runs (N,), by bootstrap.

    Fewer than FEWEST_VALUES runs cannot tell, nor can runs that all lie at the threshold.
    """
    mean, interval = bootstrap_statistic(values, np.mean, rng)
    row = claim(quantity, threshold, mean, interval, note, above=above)
    if len(values) < FEWEST_VALUES or interval == (threshold, threshold):
        row = replace(row, reproduces=Verdict.UNDECIDED)
    return row


def judge_number(
    paper: float, printed_step: float, ours: float, interval: Interval | None, contrary: float | None = None
) -> Verdict:
    """Whether ours is the printed number, as far as it is printed.

    printed_step: the last digit that the paper prints, as 0.01. contrary: what would be true if the printed number were
    wrong, as 1 for a ratio; without one, the interval must lie within WITHIN of the printed number.
    """
    if interval is None:
        return Verdict.YES if round(ours / printed_step) == round(paper / printed_step) else Verdict.NO
    (low, high), half = interval, printed_step / 2
    if high < paper - half or low > paper + half:
        return Verdict.NO
    if contrary is not None:
        return Verdict.UNDECIDED if low <= contrary <= high else Verdict.YES
    room = half + WITHIN * abs(paper)
    return Verdict.YES if paper - room <= low and high <= paper + room else Verdict.UNDECIDED


def judge_claim(threshold: float, ours: float, interval: Interval | None, *, above: bool = True) -> Verdict:
    """Whether ours, and all of its interval, lies above the threshold, or below it."""
    low, high = (ours, ours) if interval is None else interval
    if not above:
        threshold, low, high = -threshold, -high, -low
    if low > threshold:
        return Verdict.YES
    return Verdict.NO if high <= threshold else Verdict.UNDECIDED


def not_comparable(
    quantity: str, paper: float | None, ours: float, interval: Interval | None = None, why: str = ""
) -> PaperRow:
    """A row beside a printed number that ours can neither confirm nor refute; why: a sentence."""
    return _judged(quantity, ours, paper, interval, Verdict.NOT_COMPARABLE, why, "")


def _judged(
    quantity: str,
    ours: float,
    paper: float | None,
    interval: Interval | None,
    verdict: Verdict,
    note: str,
    why_not: str,
) -> PaperRow:
    low, high = interval or (None, None)
    sentences = [note, why_not] if verdict is Verdict.NO else [note]
    return PaperRow(quantity, ours, paper, low, high, verdict, " ".join(filter(None, sentences)))


def rms_interval(squares: Float) -> tuple[float, Interval]:
    """Root mean square of N independent errors from their squares (N,), and its 95 % interval.

    The mean of the squares is normal for the many errors used here; its root carries the interval over.
    """
    mean = float(np.mean(squares))
    spread = Z_95 * float(np.std(squares, ddof=1)) / np.sqrt(len(squares))
    return float(np.sqrt(mean)), (float(np.sqrt(max(mean - spread, 0.0))), float(np.sqrt(mean + spread)))


def share_interval(count: int, total: int) -> tuple[float, Interval]:
    """The share count/total and its 95 % interval after Wilson."""
    return count / total, wilson_interval(count, total)


def bootstrap_rms(mean_squares: Float, rng: np.random.Generator) -> tuple[float, Interval]:
    """Pooled root mean square of runs from their mean squares (R,), and its 95 % bootstrap interval over the runs."""
    drawn = rng.integers(len(mean_squares), size=(RESAMPLES, len(mean_squares)))
    low, high = np.percentile(np.sqrt(mean_squares[drawn].mean(axis=1)), [2.5, 97.5])
    return float(np.sqrt(mean_squares.mean())), (float(low), float(high))


def bootstrap_statistic(
    values: Float, statistic: Callable[..., Any], rng: np.random.Generator
) -> tuple[float, Interval]:
    """A statistic of N runs, with numpy's axis, and its 95 % bootstrap interval over the runs; values (N,)."""
    drawn = values[rng.integers(len(values), size=(RESAMPLES, len(values)))]
    low, high = np.percentile(statistic(drawn, axis=1), [2.5, 97.5])
    return float(statistic(values, axis=0)), (float(low), float(high))


def bootstrap_ratio(parts: Float, wholes: Float, rng: np.random.Generator) -> tuple[float, Interval]:
    """Pooled share of runs, sum of parts (R,) over sum of wholes (R,), and its 95 % bootstrap interval over the runs.

    A mean over runs is the share whose wholes are all one. Zero of zero counts as zero.
    """
    drawn = rng.integers(len(parts), size=(RESAMPLES, len(parts)))
    low, high = np.percentile(_ratio(parts[drawn].sum(axis=1), wholes[drawn].sum(axis=1)), [2.5, 97.5])
    return float(_ratio(parts.sum(), wholes.sum())), (float(low), float(high))


def _ratio(parts: Float, wholes: Float) -> Float:
    parts, wholes = np.asarray(parts, dtype=np.float64), np.asarray(wholes, dtype=np.float64)
    ratio: Float = np.divide(parts, wholes, out=np.zeros_like(parts), where=wholes > 0)
    return ratio
