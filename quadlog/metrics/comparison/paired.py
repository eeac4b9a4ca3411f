"""Differences of metrics between two runs, paired: on the instants that both have measured, with intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float
from quadlog.metrics.intervals import Interval, corrected_confidence, mean_interval_in_time
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
