"""One number of metrics.json."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from quadlog.metrics.intervals import Interval


@dataclass(frozen=True, slots=True)
class Metric:
    """A value, the number of samples it is made of, and its unit ("" for counts and shares).

    interval: 95 %, of the value; None where the samples are too few for one, or there are none. worst: the worst
    sample and its instant, None for metrics without samples in time.
    """

    value: float
    n: int
    unit: str
    interval: Interval | None = None
    worst: tuple[float, int] | None = None


Metrics = dict[str, Metric]


def saved_metrics(metrics: Metrics) -> dict[str, dict[str, Any]]:
    """The content of metrics.json: value, n and unit by name; low and high of an interval; worst and worst_t_ns."""
    return {
        name: {"value": each.value, "n": each.n, "unit": each.unit}
        | ({} if each.interval is None else {"low": each.interval[0], "high": each.interval[1]})
        | ({} if each.worst is None else {"worst": each.worst[0], "worst_t_ns": each.worst[1]})
        for name, each in metrics.items()
    }
