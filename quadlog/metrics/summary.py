"""Samples behind a value: how they scatter, how far the value is known, and when they were at their worst."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import NS_PER_S, Float, Int
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.metrics.intervals import SHORTEST_S, Interval, mean_interval_in_time, positive_interval

Statistic = Literal["mean", "std", "rms", "sum", "min", "max", "median", "p95"]


@dataclass(frozen=True, slots=True)
class Metric:
    """One number of metrics.json: a value, the number of samples it is made of, its unit ("" for counts and shares).

    interval: 95 %, of the value; None where the samples are too few for one, or there are none. worst: the worst
    sample and its instant, None for metrics without samples in time. detail: as detail_of, empty where not read.
    independent: how many independent errors its samples hold, None where that was not counted.
    """

    value: float
    n: int
    unit: str
    interval: Interval | None = None
    worst: tuple[float, int] | None = None
    detail: Mapping[str, float] = field(default_factory=dict)
    independent: float | None = None


Metrics = dict[str, Metric]


def saved_metrics(metrics: Metrics) -> dict[str, dict[str, Any]]:
    """The content of metrics.json by name: value, n, unit; low, high; worst, worst_t_ns; independent; if they apply."""
    return {
        name: {"value": each.value, "n": each.n, "unit": each.unit}
        | ({} if each.interval is None else {"low": each.interval[0], "high": each.interval[1]})
        | ({} if each.worst is None else {"worst": each.worst[0], "worst_t_ns": each.worst[1]})
        | ({} if each.independent is None else {"independent": each.independent})
        for name, each in metrics.items()
    }


@dataclass(frozen=True, slots=True)
class Samples:
    """What a value is made of: t_ns (N,) not falling, values (N,) finite, and how; independent: as in Metric."""

    t_ns: Int
    values: Float
    statistic: Statistic
    independent: float | None = None


def finite_samples(t_ns: Int, values: NDArray[Any], statistic: Statistic) -> Samples:
    """The samples (N,) that exist: NaN and infinity mean that there was nothing to measure."""
    values = values.astype(np.float64)
    known = np.isfinite(values)
    return Samples(t_ns[known], values[known], statistic)


def metrics_of(samples: Mapping[str, Samples]) -> Metrics:
    """The values of samples by the metric's name, with their intervals; none of too few samples."""
    known = {name: each for name, each in samples.items() if len(each.values) > (each.statistic == "std")}
    return {
        name: Metric(value_of(of), len(of.values), entry.unit, interval, _worst(name, of), independent=of.independent)
        for name, of in known.items()
        for entry in [CATALOGUE[name]]
        for interval in [None if entry.one_draw else interval_of(of)]
    }


def _worst(name: str, samples: Samples) -> tuple[float, int] | None:
    """The worst sample of a metric and its instant; None for totals and events, of which one is as bad as the next."""
    if samples.statistic == "sum" or np.isin(samples.values, (0.0, 1.0)).all():
        return None
    rows = worst_of(name, samples, most=1)
    return (float(samples.values[rows[0]]), int(samples.t_ns[rows[0]])) if rows else None


def detail_of(samples: Samples) -> dict[str, float]:
    """mean, std of N >= 1 samples (not of one), and p50 and p95, quantiles of their size."""
    x = samples.values
    p50, p95 = np.percentile(np.abs(x), [50, 95]).tolist()
    found = {"mean": float(np.mean(x)), "p50": p50, "p95": p95}
    return found | {"std": float(np.std(x, ddof=1))} if len(x) > 1 else found


_VALUES: dict[Statistic, Callable[[Float], Any]] = {
    "mean": np.mean,
    "std": lambda x: np.std(x, ddof=1),
    "rms": lambda x: np.sqrt(np.mean(x**2)),
    "sum": np.sum,
    "min": np.min,
    "max": np.max,
    "median": np.median,
    "p95": lambda x: np.percentile(x, 95),
}


def value_of(samples: Samples) -> float:
    """The value that N samples make, two at least for a deviation, else one."""
    return float(_VALUES[samples.statistic](samples.values))


def effects(samples: Samples) -> Float | None:
    """A series (N,) whose mean is the value, and whose every sample moves that mean as the sample moves the value.

    To first order (the delta method); None of extremes, of quantiles, of counts, and of a value of 0 that only grows.
    """
    x, value = samples.values, value_of(samples)
    if samples.statistic in ("std", "rms") and value > 0:
        squares = (x - np.mean(x)) ** 2 if samples.statistic == "std" else x**2
        return value + (squares - np.mean(squares)) / (2 * value)
    return x if samples.statistic == "mean" else None


def is_short(t_ns: Int) -> bool:
    """Whether samples at t_ns (N,) are of a log too short for an interval; for a second they may be missing."""
    return len(t_ns) == 0 or bool(t_ns[-1] - t_ns[0] < (SHORTEST_S - 1) * NS_PER_S)


def interval_of(samples: Samples) -> Interval | None:
    """95 % interval of the value, from that of the mean of its effects; see `intervals.COVERAGE`.

    It says how the value would scatter over walks as long as this one that go on as it did, not how other walks differ.
    None of extremes, of quantiles, of counts, of too few samples, and of less than SHORTEST_S.
    """
    series, x, value = effects(samples), samples.values, value_of(samples)
    found = None if series is None or is_short(samples.t_ns) else mean_interval_in_time(series)
    if found is None:
        return None
    if samples.statistic in ("std", "rms"):
        return positive_interval(value, found, upwards=2.0)
    # Nothing below 0 of samples that never are, nothing above 1 of a share.
    is_share = samples.statistic == "mean" and bool(np.isin(x, (0.0, 1.0)).all())
    low = max(found[0], 0.0) if x.min() >= 0 else found[0]
    return low, min(found[1], 1.0) if is_share else found[1]


@dataclass(frozen=True, slots=True)
class MeasuredRun:
    """A run under the name that distinguishes it, with its metrics in the contract's order."""

    path: Path
    label: str
    metrics: Mapping[str, Metric]
    recorded_s: float = math.inf


def worst_of(name: str, samples: Samples, most: int = 3) -> list[int]:
    """Indices into the samples of the metric `name`, the worst first, no two within a second; at most `most`.

    Worst are the largest in size, or the lowest where low is bad; 0 is not bad, nor is 1 or the largest of all there.
    Of equals the earlier is worse.
    """
    values, chosen = samples.values, list[int]()
    badness = values.max(initial=1.0) - values if CATALOGUE[name].worst_is_lowest else np.abs(values)
    while len(chosen) < most and badness.max(initial=0.0) > 0:
        chosen.append(int(np.argmax(badness)))
        badness = np.where(np.abs(samples.t_ns - samples.t_ns[chosen[-1]]) < NS_PER_S, 0.0, badness)
    return chosen
