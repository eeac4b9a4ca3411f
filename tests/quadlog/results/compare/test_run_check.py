from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import CannotWrite
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.results.compare.check_text import check_json, check_text
from quadlog.results.compare.expectations import Bound, parse_expectations
from quadlog.results.compare.run_check import (
    HEADER,
    RunCheck,
    bound_names,
    check_run,
    merge_bounds,
    propose,
)
from quadlog.results.run.loaded_run import Run, load_run
from quadlog.results.run.tables import METRIC_NAMES


def held(run: Path, text: str) -> RunCheck:
    return check_run(load_run(run), parse_expectations(text, "bounds.toml", METRIC_NAMES))


@pytest.mark.parametrize(
    ("bound", "reason"),
    [
        ("{ max = 0.123 }", ""),
        ("{ min = 0.123 }", ""),
        ("{ min = 0.1, max = 0.2 }", ""),
        ("{ max = 0.12299999 }", "0.123 is above max 0.12299999"),
        ("{ min = 0.12300001 }", "0.123 is below min 0.12300001"),
    ],
)
def test_bounds_include_their_ends(tiny_run: Path, bound: str, reason: str) -> None:
    check = held(tiny_run, f"[recordings.walk]\neta_m = {bound}")
    assert check.holds is (reason == "")
    assert [each.reason for each in check.checks] == [reason]


def test_an_absent_metric_does_not_hold_and_is_never_0(tiny_run: Path) -> None:
    check = held(tiny_run, "[default]\nate_rmse_m = { max = 1 }\neta_m = { max = 1 }")
    assert not check.holds
    assert [(each.value, each.holds) for each in check.checks] == [(None, False), (0.123, True)]
    assert "the run does not have this metric" in check.checks[0].reason
    (bound, _) = check_json([check])[0]["bounds"]
    assert "value" not in bound
    assert "absent" in check_text([check])


@pytest.mark.parametrize("text", ["", "[recordings.other]\neta_m = { max = 1 }", "[recordings.walk]"])
def test_a_run_of_which_nothing_is_expected_does_not_pass(tiny_run: Path, text: str) -> None:
    check = held(tiny_run, text)
    assert not check.holds
    assert check_text([check]) == (
        f"{tiny_run}: no bounds are expected of this run; add [recordings.walk] or [default]\n"
    )


def test_a_walk_goes_by_its_course_and_by_its_seed(tiny_run: Path) -> None:
    record = json.loads((tiny_run / "run.json").read_text())
    seed = tiny_run.parent / "line-fpmw" / "seed-003"
    seed.parent.mkdir()
    tiny_run.rename(seed)
    assert bound_names(load_run(seed)) == ("seed-003",)  # a recording of that name
    record["options"] = {"course": "line", "seed": 3}
    (seed / "run.json").write_text(json.dumps(record))
    assert bound_names(load_run(seed)) == ("line-fpmw", "line-fpmw/seed-003")
    assert bound_names(load_run(seed.rename(seed.parent / "baseline"))) == ("baseline",)


def test_a_run_is_named_by_where_it_really_is(tiny_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tiny_run)
    assert bound_names(load_run(Path())) == ("walk",)


def test_json_says_what_was_expected_and_found(tiny_run: Path) -> None:
    check = held(tiny_run, "[default]\neta_m = { min = 0.5 }\nfallen = { max = 0 }")
    assert check_json([check]) == [
        {
            "run": str(tiny_run),
            "name": "walk",
            "holds": False,
            "bounds": [
                {"metric": "eta_m", "min": 0.5, "value": 0.123, "holds": False, "reason": "0.123 is below min 0.5"},
                {"metric": "fallen", "max": 0.0, "value": 0.0, "holds": True},
            ],
        }
    ]


def test_a_name_that_needs_quotes_gets_them(tiny_run: Path) -> None:
    odd = tiny_run.rename(tiny_run.parent / 'a.b "c"')
    line = check_text([held(odd, "")])
    (key,) = parse_expectations(line[line.index("[") : line.index("]") + 1], "x", METRIC_NAMES).recordings
    assert key == 'a.b "c"'


PATH = Path("bounds.toml")
VALUES = st.floats(allow_nan=False, allow_infinity=False)
METRICS = st.dictionaries(st.sampled_from(METRIC_NAMES), VALUES, max_size=8)


def run(name: str, **metrics: float) -> Run:
    made = Run(Path(name), {})
    made.metrics = metrics
    return made


def proposed(**metrics: float) -> dict[str, dict[str, float]]:
    return {bound.metric: bound.sides() for bound in propose([run("a", **metrics)])["a"]}


def test_the_worse_side_is_bounded_a_tenth_beyond() -> None:
    assert proposed(eta_m=0.2, clearance_min_m=-0.5, expanded_total=2628) == {
        "clearance_min_m": {"min": -0.55},
        "eta_m": {"max": 0.22},
        "expanded_total": {"max": 2900.0},
    }
    assert proposed(yaw_rate_degps=-2.0) == {"yaw_rate_degps": {"min": -2.2, "max": -1.8}}


@pytest.mark.parametrize("name", sorted(set(METRIC_NAMES) - {"realtime_factor"}))
def test_the_side_that_is_bounded_is_the_worse_one_of_the_catalogue(name: str) -> None:
    sides = {"lower": {"max"}, "higher": {"min"}, "": {"min", "max"}}[CATALOGUE[name].better]
    assert set(proposed(**{name: 0.95})[name]) == sides


def test_a_claim_that_gets_worse_does_not_hold_the_bounds_proposed_before() -> None:
    before = {"uwb_coverage_95": 0.95, "uwb_nees": 2.0, "uwb_nis": 1.0, "reference_time_offset_s": 0.02}
    bounds = {each.metric: each for each in propose([run("a", **before)])["a"]}
    assert all(bounds[name].holds(value) for name, value in before.items())
    worse = {"uwb_coverage_95": 0.05, "uwb_nees": 0.1, "uwb_nis": 0.1, "reference_time_offset_s": -0.4}
    assert not any(bounds[name].holds(value) for name, value in worse.items())


def test_a_metric_of_another_version_is_bounded_on_both_sides() -> None:
    assert proposed(unheard_of=2.0) == {"unheard_of": {"min": 1.8, "max": 2.2}}


def test_shares_counts_and_rounding_errors() -> None:
    assert proposed(success_rate=1.0, suboptimality_mean=0.0) == {
        "success_rate": {"min": 0.99},
        "suboptimality_mean": {"max": 0.01},
    }
    assert proposed(fallen=0.0, collisions=3.0) == {"collisions": {"max": 3.0}, "fallen": {"max": 0.0}}
    assert proposed(eta_m=6.7e-16) == {"eta_m": {"max": 0.000101}}  # rounded outwards from 0.00010000000000067


def test_what_depends_on_the_machine_is_left_out() -> None:
    assert proposed(realtime_factor=3.0) == {}


def test_runs_of_one_name_share_bounds_on_what_all_have() -> None:
    bounds = propose([run("a", eta_m=0.1, sigma_m=1), run("a", eta_m=0.3), run("b", eta_m=1.0)])
    assert bounds == {"a": (Bound("eta_m", most=0.33),), "b": (Bound("eta_m", most=1.1),)}


@given(st.lists(METRICS, min_size=1, max_size=3))
def test_runs_hold_the_bounds_proposed_from_them(metrics: list[dict[str, float]]) -> None:
    bounds = propose([run("a", **each) for each in metrics])
    expectations = parse_expectations(merge_bounds(HEADER, bounds, PATH), "bounds.toml", METRIC_NAMES)
    for bound in expectations.bounds_for(("a",)):
        assert all(bound.holds(each[bound.metric]) for each in metrics)


KEPT = """\
# mine
[default] # all of them
success_rate = { min = 0.99 } # as agreed

[recordings.follow] # the fixture
uwb_rmse_m = { max = 0.4 }  # no reference, no run
eta_m = { max = 0.05 } # tight

# the last line"""


def test_comments_and_other_bounds_stay() -> None:
    merged = merge_bounds(KEPT, {"follow": [Bound("eta_m", most=0.1)], "new": [Bound("sigma_m", 0.0, 0.2)]}, PATH)
    lines = merged.splitlines()
    assert [line for line in KEPT.splitlines() if line not in lines] == ["eta_m = { max = 0.05 } # tight"]
    assert tomllib.loads(merged)["recordings"] == {
        "follow": {"uwb_rmse_m": {"max": 0.4}, "eta_m": {"max": 0.1}},
        "new": {"sigma_m": {"min": 0.0, "max": 0.2}},
    }


def test_a_new_file_has_a_section_for_each_name_and_no_other() -> None:
    lines = merge_bounds(HEADER, {"a": [Bound("eta_m", most=0.1)], "b c": [Bound("eta_m", 0.1)]}, PATH).splitlines()
    assert [line for line in lines if line.startswith("[")] == ["[recordings.a]", '[recordings."b c"]']


ADDED = {"a": [Bound("sigma_m", most=2.0)], "b": [Bound("eta_m", most=3.0)]}


@pytest.mark.parametrize(
    "text",
    [
        "[recordings]\na.eta_m.max = 1",
        "recordings.a.eta_m.max = 1",
        "[recordings.a.eta_m]\nmax = 1",
        "[default]\n[recordings.a]\n[default.eta_m]\nmax = 2",
        "[recordings.c]\n[default]\n[recordings.a]",
    ],
)
def test_other_ways_to_write_toml_are_kept(text: str) -> None:
    wanted = tomllib.loads(text)
    wanted.setdefault("recordings", {}).setdefault("a", {})["sigma_m"] = {"max": 2.0}
    wanted["recordings"]["b"] = {"eta_m": {"max": 3.0}}
    assert tomllib.loads(merge_bounds(text, ADDED, PATH)) == wanted


def test_a_layout_that_cannot_be_added_to_is_refused() -> None:
    with pytest.raises(CannotWrite, match="no bounds can be added"):
        merge_bounds("recordings = { a = { eta_m = { max = 1 } } }", ADDED, PATH)


def test_a_name_that_is_no_text_is_refused() -> None:
    with pytest.raises(CannotWrite):
        merge_bounds("", {"walk\udcff": [Bound("eta_m", most=1.0)]}, PATH)


NAMES = st.text(st.characters(codec="utf-8"), min_size=1, max_size=8)
SECTIONS = st.dictionaries(NAMES, st.dictionaries(st.sampled_from(METRIC_NAMES), st.just({"max": 1.5}), max_size=3))


@given(SECTIONS, st.dictionaries(NAMES, st.lists(st.sampled_from(METRIC_NAMES), unique=True), max_size=3))
def test_merging_is_what_dict_update_does(sections: Any, names: Any) -> None:
    text = tomli_w.dumps({"recordings": sections})
    bounds = {name: [Bound(metric, least=-1.0) for metric in metrics] for name, metrics in names.items()}
    for name, metrics in names.items():
        sections.setdefault(name, {}).update({metric: {"min": -1.0} for metric in metrics})
    assert tomllib.loads(merge_bounds(text, bounds, PATH)).get("recordings", {}) == sections
