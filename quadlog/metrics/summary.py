"""Samples behind a value: how they scatter, how far the value is known, and when they were at their worst."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float, Int
from quadlog.metrics.catalogue import CATALOGUE, ValueKind
from quadlog.metrics.intervals import Interval, mean_interval_in_time, student_interval, wilson_interval
from quadlog.metrics.metric import Metric, Metrics

ELLIPSE_95_OF_AXIS = 1.249
"""How far the 95 % ellipse of the plane reaches, of the 95 % interval of one axis: square root of 5.991 over 1.960."""

Statistic = Literal["mean", "std", "rms", "sum", "min", "max", "length of mean"]


@dataclass(frozen=True, slots=True)
class Samples:
    """What a value is made of: t_ns (N,) rising, values (N,) finite, statistic: how they make the value.

    weights: (N,) how often each counts, for the statistic rms alone; None when all count once.
    vectors: (N, 2) of the statistic "length of mean"; values are their components along their mean, whose mean is the
    same length but for rounding.
    """

    t_ns: Int
    values: Float
    statistic: Statistic
    weights: Int | None = None
    vectors: Float | None = None

    @property
    def count(self) -> int:
        """What the value rests on: the samples, each as often as it counts."""
        return len(self.values) if self.weights is None else int(self.weights.sum())

    def rows(self, index: Int) -> Samples:
        """The samples with these indices (M,)."""
        weights = None if self.weights is None else self.weights[index]
        vectors = None if self.vectors is None else self.vectors[index]
        return Samples(self.t_ns[index], self.values[index], self.statistic, weights, vectors)


def finite_samples(t_ns: Int, values: NDArray[Any], statistic: Statistic) -> Samples:
    """The samples (N,) that exist: NaN and infinity mean that there was nothing to measure."""
    values = values.astype(np.float64)
    known = np.isfinite(values)
    return Samples(t_ns[known], values[known], statistic)


def metrics_of(samples: Mapping[str, Samples]) -> Metrics:
    """The values of samples by the metric's name, with their intervals; none of too few samples."""
    known = {name: each for name, each in samples.items() if each.count > (each.statistic == "std")}
    return {
        name: Metric(value_of(of), of.count, CATALOGUE[name].unit, _interval(of), _worst(name, of))
        for name, of in known.items()
    }


_OF_EVENTS = frozenset({"fallback_share", "generated_total", "expanded_total", "success_rate"})
"""Sums of events of which one is as bad as the next; and totals, whose worst instant their mean has."""


def _worst(name: str, samples: Samples) -> tuple[float, int] | None:
    """The worst sample of a metric and its instant; None for counts of events."""
    if CATALOGUE[name].kind in ("count", "yes or no") or name in _OF_EVENTS or samples.statistic == "length of mean":
        return None
    rows = worst_of(name, samples, most=1)
    return (float(samples.values[rows[0]]), int(samples.t_ns[rows[0]])) if rows else None


@dataclass(frozen=True, slots=True)
class SampleSummary:
    """A value of n samples; mean and sample std of these, and quantiles of their size; interval: 95 %, of the value.

    None where there is nothing to say: a deviation or an interval of too few samples, or of samples all alike.
    """

    value: float
    n: int
    mean: float
    std: float | None
    p50: float
    p95: float
    interval: Interval | None


def summarise(samples: Samples) -> SampleSummary | None:
    """The summary of a run's samples in time order; None when there are none.

    The interval says how the value would scatter over walks as long as this one that go on as it did. It treats
    neighbours in time as dependent (`mean_interval_in_time`); it knows nothing of how other walks would differ.
    """
    x = samples.values
    if samples.count == 0:
        return None
    p50, p95 = (float(each) for each in np.percentile(np.abs(x), [50, 95]))
    return SampleSummary(
        value=value_of(samples),
        n=samples.count,
        mean=float(np.mean(x)),
        std=float(np.std(x, ddof=1)) if len(x) > 1 else None,
        p50=p50,
        p95=p95,
        interval=_interval(samples),
    )


def value_of(samples: Samples) -> float:
    """The value that N >= 1 samples make; NaN for the deviation of one."""
    x, weights = samples.values, samples.weights
    match samples.statistic:
        case "mean":
            return float(np.mean(x))
        case "std":
            return float(np.std(x, ddof=1)) if len(x) > 1 else math.nan
        case "rms":
            if weights is not None:
                return float(float(np.sum(x**2 * weights)) / int(weights.sum())) ** 0.5
            return float(np.sqrt(np.mean(x**2)))
        case "sum":
            return float(np.sum(x))
        case "min":
            return float(np.min(x))
        case "max":
            return float(np.max(x))
        case "length of mean":
            assert samples.vectors is not None
            return float(np.hypot(*samples.vectors.mean(axis=0)))


def _interval(samples: Samples) -> Interval | None:
    """Of the value, from the interval of the mean that it is a function of; an extreme is none."""
    x, weights = samples.values, samples.weights
    match samples.statistic:
        case "mean":
            return _possible(mean_interval_in_time(x), x)
        case "length of mean":
            return _length_interval(mean_interval_in_time(x))
        case "std":
            return _root(mean_interval_in_time((x - np.mean(x)) ** 2))
        case "rms" if weights is not None:
            # The ratio of two sums moves with a sample as this moves, to first order.
            inner = float(np.sum(x**2 * weights)) / float(weights.sum())
            return _root(mean_interval_in_time(inner + weights * (x**2 - inner) / np.mean(weights)))
        case "rms":
            return _root(mean_interval_in_time(x**2))
        case "sum":
            of_mean = _possible(mean_interval_in_time(x), x)
            return None if of_mean is None else (of_mean[0] * len(x), of_mean[1] * len(x))
        case "min" | "max":
            return None


def _possible(of_mean: Interval | None, x: Float) -> Interval | None:
    """The interval without what no mean can be: below 0 of samples that never are, above 1 of a share's."""
    if of_mean is None or x.min() < 0:
        return of_mean
    is_share = bool(np.isin(x, (0.0, 1.0)).all())
    return max(of_mean[0], 0.0), min(of_mean[1], 1.0) if is_share else of_mean[1]


def _length_interval(along: Interval | None) -> Interval | None:
    """The interval of a mean's length from that along the mean: from 0 where zero lies in the mean's 95 % ellipse.

    The direction follows the noise, so along it alone a mean without bias would exclude 0 in 15 % of the logs.
    """
    if along is None:
        return None
    length, half = (along[1] + along[0]) / 2, (along[1] - along[0]) / 2
    return (along[0] if length > ELLIPSE_95_OF_AXIS * half else 0.0, along[1])


def _root(of_square: Interval | None) -> Interval | None:
    """The square's interval as its root's; a square is not negative."""
    return None if of_square is None else (math.sqrt(max(of_square[0], 0.0)), math.sqrt(max(of_square[1], 0.0)))


@dataclass(frozen=True, slots=True)
class Measured:
    """A metric's value, n, unit and 95 % interval; summary: of the samples behind it, None where none were read."""

    value: float
    n: int
    unit: str
    interval: Interval | None = None
    summary: SampleSummary | None = None


@dataclass(frozen=True, slots=True)
class MeasuredRun:
    """A run under the name that distinguishes it, with its metrics in the contract's order."""

    path: Path
    label: str
    metrics: Mapping[str, Measured]


@dataclass(frozen=True, slots=True)
class Spread:
    """Over the runs that have the metric: mean, sample standard deviation, quantiles, and the extremes.

    interval: 95 %, of the mean over all runs that could have been; None for one run, runs all alike, and counts.
    lowest, highest: which of the values given are the extremes, the first where several are.
    """

    runs: int
    mean: float
    std: float | None
    p50: float
    p95: float
    interval: Interval | None
    lowest: int
    highest: int


def spread(values: Sequence[float], kind: ValueKind = "quantity") -> Spread | None:
    """Of R runs, None without one. The runs count as independent of one another.

    The interval of quantities is Student's; that of "yes or no", values of 0 or 1, is Wilson's: it stays inside [0, 1],
    and wide when all are alike. Counts have none: few runs say nothing of how a count is distributed.
    """
    if not values:
        return None
    x = np.asarray(values, dtype=np.float64)
    p50, p95 = (float(each) for each in np.percentile(x, [50, 95]))
    alike = bool(np.ptp(x) == 0)  # whose mean rounding would move
    return Spread(
        runs=len(x),
        mean=float(x[0]) if alike else float(np.mean(x)),
        std=None if len(x) < 2 else 0.0 if alike else float(np.std(x, ddof=1)),
        p50=p50,
        p95=p95,
        interval=_interval_of_mean(x, kind, alike),
        lowest=int(np.argmin(x)),
        highest=int(np.argmax(x)),
    )


def _interval_of_mean(x: Float, kind: ValueKind, alike: bool) -> Interval | None:
    if kind == "yes or no":
        return wilson_interval(int(x.sum()), len(x)) if len(x) > 1 else None
    return None if alike or kind == "count" else student_interval(x)


APART_NS = 1_000_000_000


def worst_instants(t_ns: Int, badness: Float, most: int = 3) -> list[int]:
    """Indices into N samples, the worst first, none of them within a second of a worse one; at most `most`.

    badness: (N,), larger is worse; what is not above 0 is not bad. Of equals the earlier counts as worse.
    """
    chosen: list[int] = []
    open_ = badness > 0
    while open_.any() and len(chosen) < most:
        worst = int(np.argmax(np.where(open_, badness, -np.inf)))
        chosen.append(worst)
        open_ &= np.abs(t_ns - t_ns[worst]) >= APART_NS
    return chosen


def worst_of(name: str, samples: Samples, most: int = 3) -> list[int]:
    """As worst_instants, of the samples of the metric `name`: the largest in size, or the lowest where low is bad."""
    values = samples.values
    badness = values.max(initial=1.0) - values if CATALOGUE[name].worst_is_lowest else np.abs(values)
    return worst_instants(samples.t_ns, badness, most)
