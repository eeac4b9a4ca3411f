"""Differences of metrics of two runs, on the instants that both have measured, and means over runs, with intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from quadlog.messages import Float
from quadlog.metrics import intervals
from quadlog.metrics.catalogue import ValueKind
from quadlog.metrics.intervals import Interval, corrected_confidence, mean_interval_in_time
from quadlog.metrics.summary import Samples, effects, value_of

_EVENTS = frozenset({"stride_frequency_hz", "logged_stride_frequency_hz"})
"""Each run has these at instants of its own: what falls together by chance is no sample of the difference."""


class PairedDifference(NamedTuple):
    """The value of run B less that of run A, both of the instants that both have.

    interval: 95 %, None for counts and extremes, and where `mean_interval_in_time` has none. clear: whether 0 lies
    outside the interval that allows for all differences read together. same: both have the same samples at one time.
    """

    difference: float
    interval: Interval | None
    clear: bool
    same: bool


def paired_differences(a: Mapping[str, Samples], b: Mapping[str, Samples]) -> dict[str, PairedDifference]:
    """Each metric that both runs have samples of at some common instant, by name.

    Pairing takes out what the instant does to both runs. An interval is that of a mean in time: the sample-wise
    differences, or for other statistics than the mean the differences of their first-order effects on the value (the
    delta method), are a series whose mean is the difference.
    """
    found: dict[str, PairedDifference] = {}
    series: dict[str, Float] = {}
    for name in (name for name in a if name in b and name not in _EVENTS):
        common, *rows = np.intersect1d(a[name].t_ns, b[name].t_ns, return_indices=True)
        if len(common) <= (a[name].statistic == "std"):
            continue
        one = replace(a[name], t_ns=common, values=a[name].values[rows[0]])
        other = replace(b[name], t_ns=common, values=b[name].values[rows[1]])
        of_one, of_other = effects(one), effects(other)
        if of_one is not None and of_other is not None:
            series[name] = of_other - of_one
        interval = mean_interval_in_time(series[name]) if name in series else None
        same = np.array_equal(a[name].t_ns, b[name].t_ns) and np.array_equal(a[name].values, b[name].values)
        found[name] = PairedDifference(value_of(other) - value_of(one), interval, False, same)
    confidence = corrected_confidence(sum(each.interval is not None for each in found.values()))
    for name, each in found.items():
        wide = None if each.interval is None else mean_interval_in_time(series[name], confidence)
        found[name] = each._replace(clear=wide is not None and not wide[0] <= 0 <= wide[1])
    return found


class OverRuns(NamedTuple):
    """Mean of the values of a number of runs, NaN without any, and its 95 % interval over all that could have been."""

    mean: float
    interval: Interval | None
    runs: int


def over_runs(values: Float, kind: ValueKind = "quantity") -> OverRuns:
    """Of a metric's values (R,) of independent runs, or of seeds; those that are NaN are left out.

    The interval of quantities is Student's; that of "yes or no", 0 or 1, is Wilson's. None for counts, for fewer than
    two values, and for equal quantities: where the seed changes nothing it does not show how sure the value is.
    """
    known = values[np.isfinite(values)]
    if not len(known):
        return OverRuns(math.nan, None, 0)
    if kind == "yes or no":
        interval = intervals.wilson_interval(int(known.sum()), len(known)) if len(known) > 1 else None
    else:
        interval = intervals.student_interval(known) if kind != "count" and _vary(known, known) else None
    return OverRuns(float(np.mean(known)) if np.ptp(known) else float(known[0]), interval, len(known))


def clear_best(values: Float, *, lower: bool) -> int | None:
    """The setting that is best of all beyond doubt, from a metric's values (C, S) of C settings with the same S seeds.

    That of the best mean, if the intervals of its mean differences from each rival, seed by seed, leave out 0, with 95
    % confidence for all together (see `corrected_confidence`). Settings without any value are left out. None without a
    rival, where a value is missing otherwise (of a failed run), or where a difference is the same with every seed.
    """
    known = np.isfinite(values)
    among = np.flatnonzero(known.any(axis=1))
    if len(among) < 2 or not known[among].all():
        return None
    signed = values[among] if lower else -values[among]
    best = int(np.argmin(signed.mean(axis=1)))
    for worse_by in np.delete(signed, best, axis=0) - signed[best]:
        interval = intervals.student_interval(worse_by, corrected_confidence(len(among) - 1))
        if interval is None or not _vary(worse_by, signed) or interval[0] <= 0:
            return None
    return int(among[best])


def _vary(values: Float, among: Float) -> bool:
    """Whether the values differ by more than rounding, beside the size of those that they were computed from."""
    return bool(np.ptp(values) > 1e-12 * np.abs(among).max())
