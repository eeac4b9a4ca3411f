"""What is known of the metrics of a saved run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from quadlog.metrics.summary import Summary


@dataclass(frozen=True, slots=True)
class Measured:
    """A metric's value, n and unit; summary: of the samples behind it, None where none are saved or were read."""

    value: float
    n: int
    unit: str
    summary: Summary | None = None


@dataclass(frozen=True, slots=True)
class MeasuredRun:
    """A run under the name that tells it from the others, with its metrics in the contract's order."""

    path: Path
    label: str
    metrics: Mapping[str, Measured]
