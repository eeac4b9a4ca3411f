"""Metrics of runs held to bounds, in the language of the config's [expect]; bounds proposed from runs; JUnit XML.

A file of bounds has a table [default] for every run, and tables [recordings.NAME] for the runs of one name.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import tomli_w

from quadlog.config.schema import ExpectedRange
from quadlog.errors import CannotWrite, printable
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.results.run import Run
from quadlog.results.text import print_table, terminal_width

NO_BOUNDS = "no bounds are expected of this run"
NOT_MEASURED = "not measured"

Bounds = Mapping[str, ExpectedRange | None]
"""By metric; None takes a bound of [default] away."""


@dataclass(frozen=True, slots=True)
class BoundCheck:
    """A bound on a metric, and the run's value; None where it was not measured: then the bound does not hold."""

    metric: str
    bound: ExpectedRange
    value: float | None

    @property
    def reason(self) -> str:
        """Why the bound does not hold; empty if it does."""
        if self.bound.holds(self.value):
            return ""
        if self.value is None:
            return NOT_MEASURED
        low = self.bound.min
        return (
            f"{self.value!r} is below min {low!r}"
            if low is not None and self.value < low
            else (f"{self.value!r} is above max {self.bound.max!r}")
        )

    def to_dict(self) -> dict[str, Any]:
        """`metric, min, max, value, holds, reason`, those that apply."""
        value = {} if self.value is None else {"value": self.value}
        sides = self.bound.model_dump(exclude_none=True)
        return {"metric": self.metric, **sides, **value, "holds": not self.reason} | (
            {"reason": self.reason} if self.reason else {}
        )


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
        return self.error is None and bool(self.checks) and not any(check.reason for check in self.checks)

    def to_dict(self) -> dict[str, Any]:
        """`run, name, holds, bounds`, and `error` where the run could not be read."""
        content = {"run": self.run, "name": self.name, "holds": self.holds}
        content["bounds"] = [check.to_dict() for check in self.checks]
        return content | ({"error": self.error} if self.error is not None else {})


def bound_names(run: Run) -> tuple[str, ...]:
    """The names under which a file of bounds may list the run, the most specific one last.

    This is the name of its folder. A simulated walk in a seed folder is listed by the folder above (`line-fpmw`) or
    by both (`line-fpmw/seed-000`).
    """
    place = run.path.resolve()
    if place.name.startswith("seed-") and run.simulated:
        return place.parent.name, f"{place.parent.name}/{place.name}"
    return (place.name,)


def check_run(run: Run, bounds: Mapping[str, Bounds]) -> RunCheck:
    """Check the run's metrics against the bounds of its names. Raises NotARun for damaged metrics."""
    names = bound_names(run)
    mine: dict[str, ExpectedRange | None] = {}
    for name in ("", *names):
        mine |= bounds.get(name, {})
    checks = (BoundCheck(name, bound, run.metric(name)) for name, bound in mine.items() if bound is not None)
    return RunCheck(str(run.path), names[-1], tuple(checks))


def check_text(runs: Sequence[RunCheck]) -> str:
    """A sentence for each run, and a table of its bounds."""
    return "".join(f"{line}\n" for run in runs for line in _lines(run))


def _lines(run: RunCheck) -> list[str]:
    name = printable(run.run)
    if run.error is not None:
        return [f"{name}: cannot be checked"]
    if not run.checks:
        return [f"{name}: {NO_BOUNDS}; add {_section(run.name)} or [default]"]
    broken = sum(bool(check.reason) for check in run.checks)
    verdict = f"{broken} of {len(run.checks)} bounds do not hold" if broken else "all bounds hold"
    rows = [
        (
            *(each.metric, NOT_MEASURED if each.value is None else each.value, each.bound.min, each.bound.max),
            "DOES NOT HOLD" if each.reason else "holds",
        )
        for each in run.checks
    ]
    table = print_table(("metric", "value", "min", "max", ""), rows, width=terminal_width() - 4)
    return [f"{name}: {verdict}", *(f"    {line}" for line in table.splitlines())]


def _section(name: str) -> str:
    """The heading of a run's table, quoted as TOML wants it."""
    return tomli_w.dumps({"recordings": {printable(name): {}}}).strip()


HEADER = """\
# quadlog check: bounds on the metrics of runs, both ends included.
# [default] is for every run, [recordings.NAME] for those of one name; {} takes a bound of [default] away.
"""
_EVENTS = {"fallen": "a fall", "collisions": "contact with obstacles"}
_MACHINE_DEPENDENT = frozenset({"realtime_factor"})
_MARGIN, _LEAST_MARGIN, _SHARE_MARGIN = Decimal("0.1"), Decimal("0.0001"), Decimal("0.01")
_DIGITS = 3


def propose(runs: Sequence[Run]) -> dict[str, dict[str, ExpectedRange]]:
    """Bounds by name of the runs, from all runs of that name, on the metrics of the catalogue that each of them has.

    The worse side is bounded, both where neither is better. The margin beyond the worst run is 10 % of its value, at
    least 0.0001, which allows for rounding on another machine; 0.01 for shares, 0 for falls and contacts. Bounds are
    rounded outwards to three digits. realtime_factor has none, because it depends on the machine.
    """
    by_name: dict[str, list[Run]] = {}
    for run in runs:
        by_name.setdefault(bound_names(run)[0], []).append(run)
    return {name: _propose_for([run.metrics for run in mine]) for name, mine in by_name.items()}


def _propose_for(runs: Sequence[Mapping[str, Any]]) -> dict[str, ExpectedRange]:
    shared = [name for name in CATALOGUE if name not in _MACHINE_DEPENDENT and all(name in run for run in runs)]
    return {name: _bound(name, [float(run[name].value) for run in runs]) for name in shared}


def _bound(metric: str, values: Sequence[float]) -> ExpectedRange:
    better = CATALOGUE[metric].better
    low, high = _outwards(metric, min(values), -1), _outwards(metric, max(values), +1)
    return ExpectedRange(min=None if better == "lower" else low, max=None if better == "higher" else high)


def _outwards(metric: str, value: float, sign: int) -> float:
    if metric in _EVENTS:
        return value
    exact = Decimal(repr(value))
    margin = _SHARE_MARGIN if CATALOGUE[metric].kind == "share" else max(_MARGIN * abs(exact), _LEAST_MARGIN)
    moved = exact + sign * margin
    step = Decimal(1).scaleb(moved.adjusted() - _DIGITS + 1)
    bound = float(moved.quantize(step, rounding=ROUND_CEILING if sign > 0 else ROUND_FLOOR))
    return bound if math.isfinite(bound) else value


def accepted(metric: str, bound: ExpectedRange) -> str:
    """What a bound on events, or on the clearance, accepts that should not happen at all; empty if nothing."""
    if metric in _EVENTS and (bound.max or 0) > 0:
        return f"{_EVENTS[metric]} ({metric})"
    if metric == "clearance_min_m" and bound.min is not None and bound.min <= 0:
        return f"the body in an obstacle ({metric})"
    return ""


def bounds_toml(bounds: Mapping[str, Mapping[str, ExpectedRange]], path: Path) -> bytes:
    """A file of bounds; path: its name in errors. Raises CannotWrite for a name that is no text."""
    lines = [HEADER]
    for name, mine in bounds.items():
        lines.append(tomli_w.dumps({"recordings": {name: {}}}))
        for metric, bound in mine.items():
            sides = ", ".join(f"{side} = {value!r}" for side, value in bound.model_dump(exclude_none=True).items())
            event = accepted(metric, bound)
            comment = f"  # accepts {event}; edit it unless that is meant" if event else ""
            lines.append(f"{metric} = {{ {sides} }}{comment}\n")
        lines.append("\n")
    try:
        return "".join(lines).rstrip("\n").encode() + b"\n"
    except UnicodeEncodeError as error:
        raise CannotWrite(path, "the name of a run is no text") from error


def junit_xml(runs: Sequence[RunCheck], labels: Sequence[str]) -> bytes:
    """The document, in the schema that Jenkins plug-ins share; labels: distinct names of the runs.

    A bound that does not hold and a run without bounds are failures; a run that cannot be read is an error.
    """
    root = ET.Element("testsuites", name="quadlog check")
    for run, label in zip(runs, map(printable, labels), strict=True):
        found = [(check.metric, "failure", check.reason) for check in run.checks]
        if run.error is not None:
            found = [("run", "error", run.error)]
        cases = found or [("expectations", "failure", NO_BOUNDS)]
        suite = ET.SubElement(root, "testsuite", name=label)
        for name, kind, why in cases:
            case = ET.SubElement(suite, "testcase", classname=label, name=name)
            if why:
                text = printable(f"{name}: {why}")
                ET.SubElement(case, kind, type=name, message=text).text = text
    for element in (*root, root):
        for count, kind in (("tests", "testcase"), ("failures", "failure"), ("errors", "error")):
            element.set(count, str(len(list(element.iter(kind)))))
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"
