from __future__ import annotations

from xml.etree import ElementTree as ET

from hypothesis import given
from hypothesis import strategies as st

from quadlog.results.compare.check_text import junit_xml
from quadlog.results.compare.expectations import Bound
from quadlog.results.compare.run_check import BoundCheck, RunCheck

# The common schema of Jenkins's plug-ins (junit-10): attributes required, attributes allowed, children allowed.
SCHEMA: dict[str, tuple[set[str], set[str], set[str]]] = {
    "testsuites": (set(), {"name", "time", "tests", "failures", "errors"}, {"testsuite"}),
    "testsuite": ({"name", "tests", "failures", "errors"}, {"skipped", "time", "timestamp", "id"}, {"testcase"}),
    "testcase": ({"name"}, {"classname", "time", "group"}, {"failure", "error", "skipped"}),
    "failure": (set(), {"type", "message"}, set()),
    "error": (set(), {"type", "message"}, set()),
}

HOLDS = BoundCheck(Bound("eta_m", most=1.0), 0.5)
BROKEN = BoundCheck(Bound("sigma_m", least=1.0), 0.5)
ABSENT = BoundCheck(Bound("ate_rmse_m", most=1.0), None)
RUNS = st.lists(
    st.builds(
        lambda name, checks, error: RunCheck(name, name, () if error is not None else tuple(checks), error),
        st.text(max_size=10),
        st.lists(st.sampled_from([HOLDS, BROKEN, ABSENT]), max_size=4),
        st.none() | st.text(max_size=20),
    ),
    max_size=4,
)


def follow_schema(element: ET.Element) -> None:
    required, allowed, children = SCHEMA[element.tag]
    assert required <= set(element.attrib) <= required | allowed
    for child in element:
        assert child.tag in children
        follow_schema(child)


@given(RUNS)
def test_any_checks_are_valid_xml_whose_counts_are_right(runs: list[RunCheck]) -> None:
    root = ET.fromstring(junit_xml(runs, [run.run for run in runs]))
    follow_schema(root)
    assert len(root) == len(runs)
    for run, suite in zip(runs, root, strict=True):
        broken = sum(not check.holds for check in run.checks)
        nothing = run.error is None and not run.checks
        assert suite.get("tests") == str(max(1, len(run.checks)))
        assert suite.get("failures") == str(broken + nothing)
        assert suite.get("errors") == str(int(run.error is not None))
        assert run.holds is (suite.find(".//failure") is None and suite.find(".//error") is None)
    for count in ("tests", "failures", "errors"):
        assert root.get(count) == str(sum(int(suite.get(count, "")) for suite in root))


def test_a_case_says_what_broke() -> None:
    text = junit_xml([RunCheck("r", "r", (HOLDS, BROKEN, ABSENT))], ['<a> & "b"\x1b[31m'])
    (suite,) = ET.fromstring(text)
    assert suite.get("name") == '<a> & "b"\N{REPLACEMENT CHARACTER}[31m'
    cases = {case.get("name"): case for case in suite}
    assert len(cases["eta_m"]) == 0
    assert cases["sigma_m"][0].get("message") == "sigma_m: 0.5 is below min 1.0"
    assert cases["ate_rmse_m"][0].text == "ate_rmse_m: the run does not have this metric"
    assert text.startswith(b"<?xml version='1.0' encoding='utf-8'?>\n")
