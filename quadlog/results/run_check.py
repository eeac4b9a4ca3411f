"""Saved metrics of a run held against the bounds that are expected of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from quadlog.errors import QuadlogError
from quadlog.results.expectations import Bound, Expectations
from quadlog.results.run_folder import read_metrics, read_run_json

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
