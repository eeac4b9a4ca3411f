"""Saved metrics of runs checked against bounds; bounds proposed from runs."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from quadlog.errors import CannotWrite
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.results.compare.expectations import Bound, Expectations
from quadlog.results.run.loaded_run import Run

NO_BOUNDS = "no bounds are expected of this run"


@dataclass(frozen=True, slots=True)
class BoundCheck:
    """A bound and the run's value: None when the run does not have the metric, and the bound does not hold."""

    bound: Bound
    value: float | None

    @property
    def holds(self) -> bool:
        """Whether there is a value within the bound."""
        return self.value is not None and self.bound.holds(self.value)

    @property
    def reason(self) -> str:
        """Why the bound does not hold; empty if it does."""
        if self.value is None:
            return "the run does not have this metric"
        if self.bound.least is not None and self.value < self.bound.least:
            return f"{self.value!r} is below min {self.bound.least!r}"
        if self.bound.most is not None and self.value > self.bound.most:
            return f"{self.value!r} is above max {self.bound.most!r}"
        return ""


@dataclass(frozen=True, slots=True)
class RunCheck:
    """The checks of one run. error: why it could not be read, else None."""

    run: str
    name: str
    checks: tuple[BoundCheck, ...] = ()
    error: str | None = None

    @property
    def holds(self) -> bool:
        """Whether all bounds hold. A run without any bounds does not pass."""
        return self.error is None and bool(self.checks) and all(check.holds for check in self.checks)


def bound_names(run: Run) -> tuple[str, ...]:
    """The names under which a file of bounds may list the run, the most specific one last.

    This is the name of its folder. A simulated walk in a seed folder is listed by the folder above (`line-fpmw`) or
    by both (`line-fpmw/seed-000`).
    """
    place = run.path.resolve()
    options = run.record.get("options")
    if place.name.startswith("seed-") and isinstance(options, dict) and "course" in options:
        return place.parent.name, f"{place.parent.name}/{place.name}"
    return (place.name,)


def check_run(run: Run, expectations: Expectations) -> RunCheck:
    """Check the run's metrics against the bounds of its names. Raises NotARun for damaged metrics."""
    names, metrics = bound_names(run), {name: float(value) for name, value in run.metrics.items()}
    checks = tuple(BoundCheck(bound, metrics.get(bound.metric)) for bound in expectations.bounds_for(names))
    return RunCheck(str(run.path), names[-1], checks)


HEADER = """\
# quadlog check: bounds on the metrics of runs, both ends included.
# [default] is for every run, [recordings.NAME] for those of one name; {} takes a bound of [default] away.
"""

_MARGIN = Decimal("0.1")
_DIGITS = 3
_LEAST_MARGIN = Decimal("0.0001")  # allows for rounding errors on another machine
_SHARE_MARGIN = Decimal("0.01")

_EVENTS = {"fallen": "a fall", "collisions": "contact with obstacles"}
_SHARES = frozenset(
    {
        *("success_rate", "fallback_share", "torque_saturation_share", "suboptimality_mean", "uwb_coverage_95"),
        *("duty_factor", "logged_duty_factor"),
    }
)
_MACHINE_DEPENDENT = frozenset({"realtime_factor"})


def propose(runs: Sequence[Run]) -> dict[str, tuple[Bound, ...]]:
    """Bounds by name, from all runs of that name, of the metrics that each of them has.

    Only the worse side is bounded, or both where the catalogue calls neither better. The margin beyond the worst run
    is 10 % of its value, at least 0.0001; 0.01 for shares, 0 for counts. Bounds are rounded outwards to three digits.
    realtime_factor has no bound, because it depends on the machine.
    """
    by_name: dict[str, list[Mapping[str, float]]] = {}
    for run in runs:
        by_name.setdefault(bound_names(run)[0], []).append(run.metrics)
    return {name: _propose_for(each) for name, each in by_name.items()}


def accepted_events(bounds: Mapping[str, Sequence[Bound]]) -> dict[str, list[str]]:
    """By name, what the proposed bounds accept that should not happen at all: contacts and falls, in words."""
    words = {
        name: [f"{_accepts(bound)} ({bound.metric})" for bound in each if _accepts(bound)]
        for name, each in bounds.items()
    }
    return {name: each for name, each in words.items() if each}


def _accepts(bound: Bound) -> str:
    """What a bound on a count of events, or on the clearance, accepts; empty if nothing."""
    if bound.metric in _EVENTS and (bound.most or 0) > 0:
        return _EVENTS[bound.metric]
    if bound.metric == "clearance_min_m" and bound.least is not None and bound.least <= 0:
        return "the body in an obstacle"
    return ""


def merge_bounds(text: str, bounds: Mapping[str, Sequence[Bound]], path: Path) -> str:
    """The TOML `text` of the file `path` with these bounds set; comments and all else are kept.

    Raises CannotWrite for a layout in which this cannot be done.
    """
    expected: dict[str, Any] = tomllib.loads(text)
    for name, each in bounds.items():
        expected.setdefault("recordings", {}).setdefault(name, {}).update({b.metric: b.sides() for b in each})
    try:
        document = tomlkit.parse(text)
        recordings = document.setdefault("recordings", tomlkit.table())
        for name, each in bounds.items():
            section = recordings.setdefault(name, tomlkit.table())
            for bound in each:
                inline = tomlkit.inline_table()
                inline.update(bound.sides())
                if accepted := _accepts(bound):
                    inline.comment(f"accepts {accepted}; edit it unless that is meant")
                section[bound.metric] = inline
        merged = tomlkit.dumps(document)
        if tomllib.loads(merged.encode().decode()) == expected:
            return merged
    except (TOMLKitError, ValueError, TypeError, AttributeError, RecursionError):
        pass  # tomlkit does not support every layout that TOML allows
    raise CannotWrite(path, "no bounds can be added to a file of this layout; write them to another file")


def _propose_for(runs: Sequence[Mapping[str, float]]) -> tuple[Bound, ...]:
    shared = set(runs[0]).intersection(*runs[1:]) - _MACHINE_DEPENDENT
    return tuple(_bound(name, [float(metrics[name]) for metrics in runs]) for name in sorted(shared))


def _bound(metric: str, values: Sequence[float]) -> Bound:
    least = _outwards(metric, min(values), -1)
    most = _outwards(metric, max(values), +1)
    better = CATALOGUE[metric].better if metric in CATALOGUE else ""
    return Bound(metric, None if better == "lower" else least, None if better == "higher" else most)


def _outwards(metric: str, value: float, sign: int) -> float:
    if metric in _EVENTS:
        return value
    exact = Decimal(repr(value))
    margin = _SHARE_MARGIN if metric in _SHARES else max(_MARGIN * abs(exact), _LEAST_MARGIN)
    moved = exact + sign * margin
    step = Decimal(1).scaleb(moved.adjusted() - _DIGITS + 1)
    bound = float(moved.quantize(step, rounding=ROUND_CEILING if sign > 0 else ROUND_FLOOR))
    return bound if math.isfinite(bound) else value
