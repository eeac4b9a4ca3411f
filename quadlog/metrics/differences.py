"""Differences of metrics with their intervals: of two runs, on the instants that both have measured, and over seeds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from quadlog.messages import Float
from quadlog.metrics.intervals import Interval, corrected_confidence, mean_interval_in_time, student_interval
from quadlog.metrics.summary import Samples, effects, value_of

_EVENTS = frozenset({"stride_frequency_hz", "logged_stride_frequency_hz"})
"""Each run has these at instants of its own: what falls together by chance is no sample of the difference."""


@dataclass(frozen=True, slots=True)
class PairedDifference:
    """The value of run B less that of run A, both of the instants that both have.

    interval: 95 %, None for counts and extremes, and where `mean_interval_in_time` has none. clear: whether 0 lies
    outside of the interval that allows for all the differences that are read together. pairs: number of common
    instants; alone_a, alone_b: of the others. same: both have the same samples at the
    same instants.
    """

    difference: float
    interval: Interval | None
    clear: bool
    pairs: int
    alone_a: int
    alone_b: int
    same: bool


@dataclass(frozen=True, slots=True)
class _Pair:
    """Samples of both runs at the same instants (N,), and how many there are of each at other instants."""

    a: Samples
    b: Samples
    alone_a: int
    alone_b: int


def paired_differences(a: Mapping[str, Samples], b: Mapping[str, Samples]) -> dict[str, PairedDifference]:
    """Each metric that both runs have samples of at some common instant, by name.

    Pairing takes out what the instant does to both runs. An interval is that of a mean in time: the sample-wise
    differences, or for other statistics than the mean the differences of their first-order effects on the value (the
    delta method), are a series whose mean is the difference.
    """
    names = [name for name in a if name in b and name not in _EVENTS]
    pairs = {name: pair for name in names if (pair := _paired(a[name], b[name])) is not None}
    series = {name: _difference_in_time(pair) for name, pair in pairs.items()}
    intervals = {name: None if each is None else mean_interval_in_time(each) for name, each in series.items()}
    confidence = corrected_confidence(sum(interval is not None for interval in intervals.values()))
    found = {}
    for name, pair in pairs.items():
        each = series[name]
        wide = None if each is None or intervals[name] is None else mean_interval_in_time(each, confidence)
        found[name] = PairedDifference(
            difference=value_of(pair.b) - value_of(pair.a),
            interval=intervals[name],
            clear=wide is not None and not wide[0] <= 0 <= wide[1],
            pairs=len(pair.a.t_ns),
            alone_a=pair.alone_a,
            alone_b=pair.alone_b,
            same=not (pair.alone_a or pair.alone_b) and np.array_equal(pair.a.values, pair.b.values),
        )
    return found


def _paired(a: Samples, b: Samples) -> _Pair | None:
    """The samples at the instants that both have; None where these are too few for a value."""
    common, in_a, in_b = np.intersect1d(a.t_ns, b.t_ns, return_indices=True)
    if len(common) <= (a.statistic == "std"):
        return None
    return _Pair(a.rows(in_a), b.rows(in_b), len(a.t_ns) - len(common), len(b.t_ns) - len(common))


def _difference_in_time(pair: _Pair) -> Float | None:
    """A series (N,) whose mean is the difference; None of counts and extremes: all metrics that are sums are counts."""
    of_a, of_b = effects(pair.a), effects(pair.b)
    return None if of_a is None or of_b is None or pair.a.statistic == "sum" else of_b - of_a


_ROUNDING = 1e-12


class OverSeeds(NamedTuple):
    """Mean of the values that are known, NaN without any; low, high: its 95 % interval, None where seeds give none."""

    mean: float
    low: float | None
    high: float | None


def over_seeds(values: Float) -> OverSeeds:
    """Mean and Student's interval of a metric's values (S,) over seeds, NaN where it has none.

    No interval for fewer than two values, nor for equal ones: then the seed changes nothing, and does not show how
    sure the value is.
    """
    known = values[np.isfinite(values)]
    if not len(known):
        return OverSeeds(math.nan, None, None)
    interval = student_interval(known) if _vary(known, known) else None
    return OverSeeds(float(np.mean(known)), *(interval or (None, None)))


def clear_best(values: Float, *, lower: bool) -> int | None:
    """The setting that is best of all beyond doubt, from a metric's values (C, S) of C settings with the same S seeds.

    The setting of the best mean is compared with each rival by the differences between runs of one seed: it is best
    when the interval of each mean difference leaves out 0, with 95 % confidence for all rivals together (Bonferroni,
    which also allows for the choice of the best among several, Hsu 1984).

    Settings without any value are left out. None when there is no rival, when a value is missing otherwise (runs
    that failed are not left out in silence), or when a difference is the same with every seed: it may be chance that
    no seed shows.
    """
    known = np.isfinite(values)
    among = np.flatnonzero(known.any(axis=1))
    if len(among) < 2 or not known[among].all():
        return None
    signed = values[among] if lower else -values[among]
    best = int(np.argmin(signed.mean(axis=1)))
    rivals = np.delete(signed, best, axis=0)
    confidence = corrected_confidence(len(rivals))
    for rival in rivals:
        worse_by = rival - signed[best]
        interval = student_interval(worse_by, confidence) if _vary(worse_by, values[among]) else None
        if interval is None or interval[0] <= 0:
            return None
    return int(among[best])


def _vary(values: Float, among: Float) -> bool:
    """Whether the values differ by more than rounding, beside the size of those that they were computed from."""
    return bool(np.ptp(values) > _ROUNDING * np.abs(among).max())
