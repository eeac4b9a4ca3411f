"""Checks as text, JSON and JUnit XML."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from typing import Any
from xml.etree import ElementTree as ET

from quadlog.errors import printable
from quadlog.results.compare.run_check import NO_BOUNDS, BoundCheck, RunCheck


def check_text(runs: Sequence[RunCheck]) -> str:
    """A paragraph per run with a line per bound."""
    return "".join(f"{line}\n" for run in runs for line in _lines(run))


def check_json(runs: Sequence[RunCheck]) -> list[dict[str, Any]]:
    """A list with one object per run: `run, name, holds, bounds`, and `error` where it could not be read.

    A bound has `metric, min, max, value, holds, reason`, those that apply.
    """
    return [_run_json(run) for run in runs]


def _run_json(run: RunCheck) -> dict[str, Any]:
    content: dict[str, Any] = {"run": run.run, "name": run.name, "holds": run.holds}
    content["bounds"] = [_bound_json(check) for check in run.checks]
    return content | ({"error": run.error} if run.error is not None else {})


def _bound_json(check: BoundCheck) -> dict[str, Any]:
    content: dict[str, Any] = {"metric": check.bound.metric, **check.bound.sides(), "holds": check.holds}
    value = {} if check.value is None else {"value": check.value}
    return content | value | ({} if check.holds else {"reason": check.reason})


def _lines(run: RunCheck) -> Iterator[str]:
    name = printable(run.run)
    if run.error is not None:
        yield f"{name}: cannot be checked"
        return
    if not run.checks:
        yield f"{name}: {NO_BOUNDS}; add [recordings.{printable(_key(run.name))}] or [default]"
        return
    broken = sum(not check.holds for check in run.checks)
    yield f"{name}: {f'{broken} of {len(run.checks)} bounds do not hold' if broken else 'all bounds hold'}"
    width = max(len(check.bound.metric) for check in run.checks)
    for check in run.checks:
        value = "absent" if check.value is None else f"{check.value:.6g}"
        verdict = "holds" if check.holds else "DOES NOT HOLD"
        yield f"    {printable(check.bound.metric):{width}}  {value:>12}  {_range(check):24}  {verdict}".rstrip()


def _range(check: BoundCheck) -> str:
    return ", ".join(f"{side} {value:.6g}" for side, value in check.bound.sides().items())


def _key(name: str) -> str:
    """A TOML key, quoted if necessary; JSON's quotes are valid in TOML."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)


def junit_xml(runs: Sequence[RunCheck], labels: Sequence[str]) -> bytes:
    """The document, in the schema that Jenkins plug-ins share; labels: distinct names of the runs.

    A bound that does not hold and a run without bounds are failures; a run that cannot be read is an error. Control
    characters and lone surrogates, which XML cannot hold, are replaced.
    """
    root = ET.Element("testsuites", name="quadlog check")
    for run, label in zip(runs, labels, strict=True):
        root.append(_suite(run, printable(label)))
    for count in ("tests", "failures", "errors"):
        root.set(count, str(sum(int(suite.get(count, 0)) for suite in root)))
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def _suite(run: RunCheck, label: str) -> ET.Element:
    suite = ET.Element("testsuite", name=label, tests="0", failures="0", errors="0", skipped="0")
    if run.error is not None:
        ET.SubElement(_case(suite, label, "run"), "error", type="run", message=printable(run.error))
    elif not run.checks:
        ET.SubElement(_case(suite, label, "expectations"), "failure", type="expectations", message=NO_BOUNDS)
    for check in run.checks:
        case = _case(suite, label, check.bound.metric)
        if not check.holds:
            message = printable(f"{check.bound.metric}: {check.reason}")
            ET.SubElement(case, "failure", type="bound", message=message).text = message
    suite.set("tests", str(len(suite)))
    suite.set("failures", str(len(suite.findall("testcase/failure"))))
    suite.set("errors", str(len(suite.findall("testcase/error"))))
    return suite


def _case(suite: ET.Element, label: str, name: str) -> ET.Element:
    return ET.SubElement(suite, "testcase", classname=label, name=printable(name))
