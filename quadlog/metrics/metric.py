"""One number of metrics.json."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Metric:
    """A value, the number of samples it is made of, and its unit ("" for counts and shares)."""

    value: float
    n: int
    unit: str


Metrics = dict[str, Metric]
