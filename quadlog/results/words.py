"""Metrics in words, from the catalogue: values, intervals, bounds and whether they hold."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from quadlog.metrics.catalogue import CATALOGUE
from quadlog.results.numbers import percent, sig
from quadlog.results.record import SavedMetric
from quadlog.results.run import Run

State = Literal["good", "warn", "bad", ""]
"""How a sentence, value or row is coloured."""
STATES: tuple[State, ...] = ("bad", "warn", "good", "")
"""The worst first."""


def label_of(name: str) -> str:
    """The metric in words; a name that the catalogue lacks stays as it is."""
    return CATALOGUE[name].label if name in CATALOGUE else name


def value_text(name: str, value: float, unit: str = "", digits: int = 3) -> str:
    """A value with its unit: shares in percent, angles in degrees, factors with ×."""
    kind = CATALOGUE[name].kind if name in CATALOGUE else "quantity"
    if kind == "share":
        return percent(value, digits)
    if unit == "rad":
        return f"{sig(math.degrees(value), digits)}°"
    return f"{sig(value, digits)} {'×' if kind == 'factor' else unit}".strip()


def interval_text(name: str, metric: SavedMetric) -> str:
    """The 95 % interval; empty without one, and for single events, of which it says nothing."""
    kind = CATALOGUE[name].kind if name in CATALOGUE else "quantity"
    if metric.low is None or metric.high is None or kind in ("count", "yes or no"):
        return ""
    factor = 100 if kind == "share" else math.degrees(1) if metric.unit == "rad" else 1
    unit = "\u202f%" if kind == "share" else "°" if metric.unit == "rad" else ""
    return f"{sig(factor * metric.low, 2)} to {sig(factor * metric.high, 2)}{unit}"


def is_alarming(name: str, value: float) -> bool:
    """Whether the value is outside of the range that the catalogue takes as usual."""
    alarm = CATALOGUE[name].alarm if name in CATALOGUE else None
    return alarm is not None and not alarm[0] <= value <= alarm[1]


class Bound(NamedTuple):
    """The expected range of a metric, and how it came out: `bad` also where the metric was not measured."""

    words: str
    state: State


def state_of(name: str, value: float, bound: Bound | None) -> State:
    """How a value is coloured: by its bound, and without one by what is usual."""
    return bound.state if bound is not None else "warn" if is_alarming(name, value) else ""


def bounds_of(run: Run) -> dict[str, Bound]:
    """The bounds in the run's [expect], by metric."""
    found = {}
    for name, expected in (run.config.expect.model_extra or {}).items():
        unit, sides = CATALOGUE[name].unit, (("≥", expected.min), ("≤", expected.max))
        ends = [f"{sign} {value_text(name, end, unit)}" for sign, end in sides if end is not None]
        found[name] = Bound(" and ".join(ends), "good" if expected.holds(run.metric(name)) else "bad")
    return found
