"""Metrics of runs held to bounds, in the language of the config's [expect]; bounds proposed from runs; JUnit XML.

A file of bounds has a table [default] for every run, and tables [recordings.NAME] for the runs of one name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from typing import Any
from xml.etree import ElementTree as ET

import tomli_w

from quadlog.config.schema import ExpectedRange
from quadlog.errors import printable
from quadlog.metrics.catalogue import CATALOGUE, THEMES
from quadlog.results.record import SavedMetric
from quadlog.results.run import Run
from quadlog.results.text import TitledTable, print_tables, terminal_width

NO_BOUNDS = "no bounds are expected of this run"


@dataclass(frozen=True, slots=True)
class RunCheck:
    """A run held to its bounds: rows of `metric, min, max, value, holds, reason`, those that apply.

    error: why the run could not be read.
    """

    run: str
    name: str
    bounds: Sequence[Mapping[str, Any]] = ()
    error: str | None = None

    @property
    def holds(self) -> bool:
        """Whether all bounds hold. A run without any bounds does not pass."""
        return self.error is None and bool(self.bounds) and all(bound["holds"] for bound in self.bounds)

    def to_dict(self) -> dict[str, Any]:
        """As `--json` prints it, without `error` where there is none."""
        return {key: of for key, of in {**asdict(self), "holds": self.holds}.items() if of is not None}


def bound_names(run: Run) -> tuple[str, ...]:
    """The names under which a file of bounds may list the run, the most specific one last.

    This is the name of its folder. A simulated walk in a seed folder is listed by the folder above (`line-fpmw`) or
    by both (`line-fpmw/seed-000`).
    """
    place = run.path.resolve()
    if place.name.startswith("seed-") and run.simulated:
        return place.parent.name, f"{place.parent.name}/{place.name}"
    return (place.name,)


def check_run(run: Run, bounds: Mapping[str, Mapping[str, ExpectedRange | None]]) -> RunCheck:
    """Check the run's metrics against the bounds of its names; None takes away a bound. Raises NotARun."""
    names, checks = bound_names(run), []
    mine = {metric: bound for name in ("", *names) for metric, bound in bounds.get(name, {}).items()}
    for metric, bound in mine.items():
        if bound is not None:
            found, value = {"metric": metric, **bound.model_dump(exclude_none=True)}, run.metric(metric)
            found |= {"holds": bound.holds(value)} | ({} if value is None else {"value": value})
            if value is None:
                found["reason"] = "not measured"
            elif not found["holds"]:
                low = bound.min is not None and value < bound.min
                found["reason"] = f"{value!r} is {f'below min {bound.min!r}' if low else f'above max {bound.max!r}'}"
            checks.append(found)
    return RunCheck(str(run.path), names[-1], checks)


def check_text(runs: Sequence[RunCheck]) -> str:
    """A table of each run's bounds below a sentence, and then the runs that have none."""
    tables, others, words = [], [], {True: "holds", False: "DOES NOT HOLD"}
    for run in runs:
        broken = sum(not of["holds"] for of in run.bounds)
        verdict = f"{broken} of {len(run.bounds)} bounds do not hold" if broken else "all bounds hold"
        rows = [
            [of["metric"], of.get("value", "not measured"), of.get("min"), of.get("max"), words[of["holds"]]]
            for of in run.bounds
        ]
        if rows:
            tables.append(TitledTable(f"{run.run}: {verdict}", ("metric", "value", "min", "max", ""), rows))
        else:
            add = tomli_w.dumps({"recordings": {printable(run.name): {}}}).strip()
            why = "cannot be checked" if run.error is not None else f"{NO_BOUNDS}; add {add} or [default]"
            others.append(f"{run.run}: {why}")
    return print_tables(tables, "plain", others, terminal_width())


HEADER = """\
# quadlog check: bounds on the metrics of runs, both ends included.
# [default] is for every run, [recordings.NAME] for those of one name; {} takes a bound of [default] away.
"""
EVENTS = ("fallen", "collisions")  # which should be 0


def propose(runs: Sequence[Run]) -> dict[str, dict[str, ExpectedRange]]:
    """Bounds by name of the runs, from all runs of that name, on the metrics of the catalogue that each of them has.

    The worse side is bounded, both where neither is better. The margin beyond the worst run is 10 % of its value, at
    least 0.0001, which allows for rounding on another machine; 0.01 for shares, 0 for falls and contacts. Bounds are
    rounded outwards to three digits. Those of computing have none: they depend on the machine.
    """
    by_name: dict[str, list[Mapping[str, SavedMetric]]] = {}
    for run in runs:
        by_name.setdefault(bound_names(run)[0], []).append(run.metrics)
    return {
        name: {
            metric: _bound(metric, [float(run[metric].value) for run in mine])
            for metric in CATALOGUE
            if metric not in THEMES["Computing"] and all(metric in run for run in mine)
        }
        for name, mine in by_name.items()
    }


def _bound(metric: str, values: Sequence[float]) -> ExpectedRange:
    better, is_share, ends = CATALOGUE[metric].better, CATALOGUE[metric].kind == "share", []
    for worst, rounding, sign in ((min(values), ROUND_FLOOR, -1), (max(values), ROUND_CEILING, 1)):
        exact = Decimal(repr(worst))
        margin = Decimal("0.01") if is_share else max(abs(exact) / 10, Decimal("0.0001"))
        moved = exact if metric in EVENTS else exact + sign * margin
        ends.append(float(Context(3, rounding).plus(moved)))
    return ExpectedRange(min=None if better == "lower" else ends[0], max=None if better == "higher" else ends[1])


def bounds_toml(bounds: Mapping[str, Mapping[str, ExpectedRange]]) -> bytes:
    """A file of bounds."""
    text = HEADER
    for name, mine in bounds.items():
        text += f"{tomli_w.dumps({'recordings': {name: {}}})}"
        for metric, bound in mine.items():
            sides = ", ".join(f"{side} = {value!r}" for side, value in bound.model_dump(exclude_none=True).items())
            text += f"{metric} = {{ {sides} }}\n"
        text += "\n"
    return text.rstrip("\n").encode("utf-8", "replace") + b"\n"


def junit_xml(runs: Sequence[RunCheck], labels: Sequence[str]) -> bytes:
    """The document, in the schema that Jenkins plug-ins share; labels: distinct names of the runs.

    A bound that does not hold and a run without bounds are failures; a run that cannot be read is an error.
    """
    root = ET.Element("testsuites", name="quadlog check")
    for run, label in zip(runs, map(printable, labels), strict=True):
        none = {"metric": "expectations", "reason": NO_BOUNDS} if run.error is None else {"metric": "run"}
        suite = ET.SubElement(root, "testsuite", name=label)
        for bound in run.bounds or [none]:
            case = ET.SubElement(suite, "testcase", classname=label, name=bound["metric"])
            if why := bound.get("reason", run.error):
                text, kind = printable(f"{bound['metric']}: {why}"), "failure" if run.error is None else "error"
                ET.SubElement(case, kind, type=bound["metric"], message=text).text = text
    for element in (*root, root):
        for count, kind in (("tests", "testcase"), ("failures", "failure"), ("errors", "error")):
            element.set(count, str(len(list(element.iter(kind)))))
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"
