"""Saved metrics of a run held against the bounds that are expected of them; bounds proposed from a run."""

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

from quadlog.errors import CannotWrite, QuadlogError
from quadlog.results.compare.expectations import Bound, Expectations
from quadlog.results.run.run_folder import read_metrics, read_run_json

NO_BOUNDS = "no bounds are expected of this run"


@dataclass(frozen=True, slots=True)
class SavedRun:
    """What a check needs of a run. names: those its bounds may stand under, the more particular one last."""

    path: Path
    names: tuple[str, ...]
    metrics: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class BoundCheck:
    """A bound, and the value it was held against: None when the run does not have that metric, and it cannot hold."""

    bound: Bound
    value: float | None

    @property
    def holds(self) -> bool:
        """Whether there is a value, and it lies within the bound."""
        return self.value is not None and self.bound.holds(self.value)

    @property
    def reason(self) -> str:
        """Why it does not hold; empty where it does."""
        if self.value is None:
            return "the run does not have this metric"
        if self.bound.least is not None and self.value < self.bound.least:
            return f"{self.value!r} is below min {self.bound.least!r}"
        if self.bound.most is not None and self.value > self.bound.most:
            return f"{self.value!r} is above max {self.bound.most!r}"
        return ""


@dataclass(frozen=True, slots=True)
class RunCheck:
    """A run with all its bounds. error: why it could not be read, else None."""

    run: str
    name: str
    checks: tuple[BoundCheck, ...] = ()
    error: str | None = None

    @property
    def holds(self) -> bool:
        """Whether there was something to hold, and all of it does: a run of which nothing is expected never passes."""
        return self.error is None and bool(self.checks) and all(check.holds for check in self.checks)


def read_saved_run(run: Path) -> SavedRun:
    """Metrics and names of a finished run. Raises NotARun, UnknownRunFormat.

    A run goes by the name of its folder. A simulated walk whose folder is its
    seed goes by the folder above (`line-fpmw`), and by both (`line-fpmw/seed-000`).
    """
    record = read_run_json(run)
    place = run.resolve()
    course = place.parent.name
    names = (course, f"{course}/{place.name}") if _is_seed(place.name, record) else (place.name,)
    return SavedRun(run, names, {name: float(metric["value"]) for name, metric in read_metrics(run).items()})


def read_or_explain(run: Path) -> SavedRun | RunCheck:
    """The run, or the check that it fails because it cannot be read."""
    try:
        return read_saved_run(run)
    except QuadlogError as error:
        return RunCheck(str(run), run.resolve().name, error=str(error))


def check_run(run: SavedRun, expectations: Expectations) -> RunCheck:
    """Hold the run against what is expected of it."""
    bounds = expectations.bounds_for(run.names)
    return RunCheck(
        str(run.path), run.names[-1], tuple(BoundCheck(bound, run.metrics.get(bound.metric)) for bound in bounds)
    )


def _is_seed(folder: str, record: Mapping[str, Any]) -> bool:
    options = record.get("options")
    return folder.startswith("seed-") and isinstance(options, dict) and "course" in options


HEADER = """\
# quadlog check: bounds on the metrics of runs, both ends included.
# [default] is for every run, [recordings.NAME] for those of one name; {} takes a bound of [default] away.
"""

_MARGIN = Decimal("0.1")
_DIGITS = 3
_LEAST_MARGIN = Decimal("0.0001")  # rounding errors of another machine are not a change for the worse
_SHARE_MARGIN = Decimal("0.01")

_COUNTS = frozenset({"fallen", "collisions"})
_SHARES = frozenset({"success_rate", "fallback_share", "torque_saturation_share", "suboptimality_mean"})
_LARGER_IS_BETTER = frozenset({"success_rate", "clearance_min_m", "ratio_to_astar"})
_NEITHER_IS_BETTER = frozenset({"following_distance_mean_m", "lateral_drift_m", "yaw_rate_degps", "forward_m"})
_OF_THE_MACHINE = frozenset({"realtime_factor"})


def propose(runs: Sequence[SavedRun]) -> dict[str, tuple[Bound, ...]]:
    """Bounds by name, from all runs of that name, of the metrics that each of them has.

    Only the side that is worse is bounded, where one is. The margin beyond the
    worst run is a tenth of its value, at least 0.0001; for a share 0.01, for a
    count nothing. Bounds are rounded outwards to three digits. realtime_factor
    has none, for it depends on the machine.
    """
    by_name: dict[str, list[SavedRun]] = {}
    for run in runs:
        by_name.setdefault(run.names[0], []).append(run)
    return {name: _propose_for(each) for name, each in by_name.items()}


def merge_bounds(text: str, bounds: Mapping[str, Sequence[Bound]], path: Path) -> str:
    """The TOML `text`, which `path` holds, with these bounds set; all else in it, comments too, stays as it is.

    Raises CannotWrite for a file laid out so that this cannot be done.
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
                section[bound.metric] = inline
        merged = tomlkit.dumps(document)
        if tomllib.loads(merged.encode().decode()) == expected:
            return merged
    except (TOMLKitError, ValueError, TypeError, AttributeError, RecursionError):
        pass  # it was not made for every layout that TOML allows
    raise CannotWrite(path, "no bounds can be added to a file laid out like this; write them to another one")


def _propose_for(runs: Sequence[SavedRun]) -> tuple[Bound, ...]:
    shared = [name for name in runs[0].metrics if all(name in run.metrics for run in runs)]
    return tuple(
        _bound(name, [run.metrics[name] for run in runs]) for name in sorted(shared) if name not in _OF_THE_MACHINE
    )


def _bound(metric: str, values: Sequence[float]) -> Bound:
    least = _outwards(metric, min(values), -1)
    most = _outwards(metric, max(values), +1)
    if metric in _NEITHER_IS_BETTER:
        return Bound(metric, least, most)
    return Bound(metric, least=least) if metric in _LARGER_IS_BETTER else Bound(metric, most=most)


def _outwards(metric: str, value: float, sign: int) -> float:
    if metric in _COUNTS:
        return value
    exact = Decimal(repr(value))
    margin = _SHARE_MARGIN if metric in _SHARES else max(_MARGIN * abs(exact), _LEAST_MARGIN)
    moved = exact + sign * margin
    step = Decimal(1).scaleb(moved.adjusted() - _DIGITS + 1)
    bound = float(moved.quantize(step, rounding=ROUND_CEILING if sign > 0 else ROUND_FLOOR))
    return bound if math.isfinite(bound) else value
