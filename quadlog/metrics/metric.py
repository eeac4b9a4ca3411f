"""One number of metrics.json."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from quadlog.metrics.intervals import Interval


@dataclass(frozen=True, slots=True)
class Metric:
    """A value, the number of samples it is made of, and its unit ("" for counts and shares).

    interval: 95 %, of the value; None where the samples are too few to tell one, or there are none.
    """

    value: float
    n: int
    unit: str
    interval: Interval | None = None


Metrics = dict[str, Metric]


def saved_metrics(metrics: Metrics) -> dict[str, dict[str, Any]]:
    """The content of metrics.json: value, n and unit by name; low and high of those that have an interval."""
    return {
        name: {"value": each.value, "n": each.n, "unit": each.unit}
        | ({} if each.interval is None else {"low": each.interval[0], "high": each.interval[1]})
        for name, each in metrics.items()
    }
