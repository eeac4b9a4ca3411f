"""Intervals for what was drawn at random, and the one rule by which a printed number reproduces."""

from __future__ import annotations

import numpy as np

from quadlog.messages import Float
from quadlog.metrics.intervals import RESAMPLES, Z_95, Interval, wilson_interval
from quadlog.results.papers.table import PaperRow


def compare(
    quantity: str,
    paper: float,
    printed_step: float,
    ours: float,
    interval: Interval | None = None,
    note: str = "",
    why_not: str = "",
) -> PaperRow:
    """A row that is judged: ours reproduces the printed number where both round alike, or the interval holds it.

    printed_step: the last digit that the paper prints, as 0.01. why_not is added to the note of a row that fails.
    """
    alike = round(ours / printed_step) == round(paper / printed_step)
    reproduces = alike or (interval is not None and interval[0] <= paper <= interval[1])
    sentences = [note] if reproduces else [note, why_not]
    low, high = interval or (None, None)
    return PaperRow(quantity, ours, paper, low, high, reproduces, " ".join(filter(None, sentences)))


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
