"""Checks as JUnit XML, which Jenkins, GitLab and others show: a suite for each run, a case for each bound."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as ET

from quadlog.results.run_check import NO_BOUNDS, RunCheck
from quadlog.text import printable


def junit_xml(runs: Sequence[RunCheck], labels: Sequence[str]) -> bytes:
    """The document, by the schema that Jenkins's plug-ins share; labels: what tells the runs apart, one each.

    A bound that does not hold is a failure, as is a run of which nothing is
    expected; a run that cannot be read is an error.
    """
    root = ET.Element("testsuites", name="quadlog check")
    for run, label in zip(runs, labels, strict=True):
        root.append(_suite(run, _text(label)))
    for count in ("tests", "failures", "errors"):
        root.set(count, str(sum(int(suite.get(count, 0)) for suite in root)))
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def _suite(run: RunCheck, label: str) -> ET.Element:
    suite = ET.Element("testsuite", name=label, tests="0", failures="0", errors="0", skipped="0")
    if run.error is not None:
        ET.SubElement(_case(suite, label, "run"), "error", type="run", message=_text(run.error))
    elif not run.checks:
        ET.SubElement(_case(suite, label, "expectations"), "failure", type="expectations", message=NO_BOUNDS)
    for check in run.checks:
        case = _case(suite, label, check.bound.metric)
        if not check.holds:
            message = _text(f"{check.bound.metric}: {check.reason}")
            ET.SubElement(case, "failure", type="bound", message=message).text = message
    suite.set("tests", str(len(suite)))
    suite.set("failures", str(len(suite.findall("testcase/failure"))))
    suite.set("errors", str(len(suite.findall("testcase/error"))))
    return suite


def _case(suite: ET.Element, label: str, name: str) -> ET.Element:
    return ET.SubElement(suite, "testcase", classname=label, name=_text(name))


def _text(text: str) -> str:
    """Without control characters and lone surrogates, which XML cannot hold."""
    return printable(text)
