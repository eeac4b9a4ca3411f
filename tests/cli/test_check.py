from __future__ import annotations

import json
import shutil
import tomllib
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.config.file import read_bounds
from quadlog.metrics.catalogue import CATALOGUE, THEMES
from quadlog.results.check import bounds_toml, propose
from quadlog.results.run import SavedMetric
from quadlog.results.tables import TABLES, write_table
from tests.lab.runs import change_json


@pytest.fixture
def bounds(tmp_path):
    path = tmp_path / "bounds.toml"
    path.write_text("[recordings.follow]\nuwb_residual_m = { max = 10 }\n")
    return path


def test_bounds_that_hold_and_one_that_does_not(follow, bounds, quadlog):
    done = quadlog("check", follow, "--expect", bounds)
    assert (done.code, done.out.splitlines()[0], done.err) == (0, f"{follow}: all bounds hold", "")
    with bounds.open("a") as file:
        file.write("[default]\nuwb_rmse_m = { max = 0.0 }\neta_m = { max = 1 }\n")
    done = quadlog("check", follow, "--expect", bounds)
    assert done.code == 4
    first, *lines = done.out.splitlines()
    assert first == f"{follow}: 2 of 3 bounds do not hold"
    verdicts = {line.split()[0]: line for line in lines}
    assert "not measured" in verdicts["eta_m"]
    assert verdicts["uwb_rmse_m"].endswith("DOES NOT HOLD")
    assert verdicts["uwb_residual_m"].endswith("holds")


def test_json_and_junit_say_the_same_and_replace_nothing(follow, bounds, tmp_path, quadlog):
    bounds.write_text("[default]\nuwb_rmse_m = { max = 0.0 }\nuwb_residual_m = { min = 0 }\n")
    junit, before = tmp_path / "out" / "report.xml", bounds.read_text()
    done = quadlog("check", follow, "--expect", bounds, "--json", "--junit", junit)
    ((content,), (suite,)) = json.loads(done.out), ET.parse(junit).getroot()
    assert {each["metric"]: each["holds"] for each in content["bounds"]} == {
        case.get("name"): case.find("failure") is None for case in suite
    }
    flags = {("--write", "--json"): 2, ("--junit", junit): 1, ("--junit", bounds, "--force"): 2}
    for more, code in {**flags, ("--junit", junit, "--force"): 4}.items():
        assert quadlog("check", follow, "--expect", bounds, *more).code == code
    assert bounds.read_text() == before


def measured(folder: Path, follow: Path, **metrics: float) -> Path:
    """A run that has these metrics alone."""
    if not folder.exists():
        shutil.copytree(follow, folder)
    found = {name: {"value": value, "n": 9, "unit": ""} for name, value in metrics.items()}
    (folder / "metrics.json").write_text(json.dumps(found))
    return folder


def proposed(run: Path, quadlog) -> dict[str, dict[str, float]]:
    path = run.parent / "proposed.toml"
    assert quadlog("check", run, "--expect", path, "--write", "--force").code == 0
    return tomllib.loads(path.read_text())["recordings"][run.name]


def test_bounds_are_on_the_worse_side_with_a_margin_of_a_tenth_a_hundredth_of_a_share_or_none_of_events(
    follow, tmp_path, quadlog
):
    run = measured(tmp_path / "run", follow, **dict.fromkeys(CATALOGUE, 0.95), of_another_version=1.0)
    found = proposed(run, quadlog)
    assert set(found) == set(CATALOGUE) - {*THEMES["Computing"]}
    sides = {"lower": {"max"}, "higher": {"min"}, "": {"min", "max"}}
    assert all(set(bound) == sides[CATALOGUE[name].better] for name, bound in found.items())
    assert "of_another_version" in quadlog("check", run, "--expect", tmp_path / "x.toml", "--write").err
    values = {"eta_m": 0.2, "clearance_min_m": -0.5, "expanded_total": 2628, "yaw_rate_degps": -2.0, "success_rate": 1}
    values |= {"suboptimality_mean": 0.0, "fallen": 0, "collisions": 3, "sigma_m": 6.7e-16}
    assert proposed(measured(tmp_path / "run", follow, **values), quadlog) == {
        "eta_m": {"max": 0.22}, "clearance_min_m": {"min": -0.55}, "expanded_total": {"max": 2900.0},
        "yaw_rate_degps": {"min": -2.2, "max": -1.8}, "success_rate": {"min": 0.99},
        "suboptimality_mean": {"max": 0.01}, "fallen": {"max": 0.0}, "collisions": {"max": 3.0},
        "sigma_m": {"max": 0.000101},  # rounded outwards
    }  # fmt: skip
    done = quadlog("check", run, "--expect", tmp_path / "x.toml", "--write", "--force")
    assert done.err == "warning: the bounds for run accept collisions\n"
    assert quadlog("check", run, "--expect", tmp_path / "x.toml").code == 0
    assert "--force" in quadlog("check", run, "--expect", tmp_path / "x.toml", "--write").err
    done = quadlog("check", follow, "--expect", tmp_path / "x.toml")
    assert (done.code, done.err) == (4, "not checked, no such run was given: run\n")
    assert "add [recordings.follow] or [default]" in done.out


VALUES = st.floats(-1e300, 1e300)


@given(st.dictionaries(st.sampled_from(sorted(CATALOGUE)), st.tuples(VALUES, VALUES), max_size=8))
def test_what_was_written_is_read_and_holds_on_the_runs_it_was_written_from(tmp_path_factory, metrics):
    path = tmp_path_factory.mktemp("bounds") / "bounds.toml"
    runs = [{name: SavedMetric(both[at]) for name, both in metrics.items()} for at in (0, 1)]
    made = [SimpleNamespace(path=Path('a.b "c"'), simulated=False, metrics=each) for each in runs]
    path.write_bytes(bounds_toml(propose(made)))
    bounds = read_bounds(path)[made[0].path.name]
    assert set(bounds) == set(metrics) - {*THEMES["Computing"]}
    assert all(bound.holds(value) for name, bound in bounds.items() for value in metrics[name])


def test_a_bound_under_a_name_replaces_that_of_all_and_none_removes_it(follow, tmp_path, bounds, quadlog, ok):
    bounds.write_text("[default]\nuwb_residual_m = { max = 0 }\n[recordings.follow]\nuwb_residual_m = {}\n")
    assert "no bounds are expected" in quadlog("check", follow, "--expect", bounds).out
    bounds.write_text("[default]\nuwb_residual_m = { max = 0 }\n[recordings.follow.uwb_residual_m]\nmax = 9\n")
    ok("check", follow, "--expect", bounds)
    seed = shutil.copytree(follow, tmp_path / "line-fpmw" / "seed-003")
    change_json(seed / "run.json", options={"course": "line"})
    for name, code in (("line-fpmw", 0), ('"line-fpmw/seed-003"', 0), ("seed-003", 4)):
        bounds.write_text(f"[recordings.{name}]\nuwb_residual_m = {{ max = 10 }}\n")
        assert quadlog("check", tmp_path / "line-fpmw", "--expect", bounds).code == code
    (seed / "metrics.json").write_text("[]")
    done = quadlog("check", tmp_path / "line-fpmw", "--expect", bounds)
    assert (done.code, done.out.splitlines()[0]) == (1, f"{seed}: cannot be checked")
    assert done.err.endswith(f"quadlog: {seed}/metrics.json: is damaged: no JSON object\n")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[default]\neta = { max = 1 }", "unknown key default.eta; did you mean default.eta_m?"),
        ("[default]\neta_m = { min = 2, max = 1 }", "default.eta_m: min must not be above max"),
        ("recordings.x = 1", "recordings.x: is a table"),
        (f"[default]\neta_m = {{ max = {'9' * 5000} }}", "not TOML"),
    ],
)
def test_a_bad_file_of_bounds_is_one_line(follow, bounds, refused, text, says):
    bounds.write_text(text)
    assert says in refused(1, "check", follow, "--expect", bounds)


def test_a_recording_without_a_run_is_no_success(bounds, follow, tmp_path, quadlog, ok):
    runs = tmp_path / "runs"
    shutil.copytree(follow, runs / "follow")
    failed = {"recording": ["broken"], "exit_code": [1], "reason": ["no bag"], "worker": [""]}
    write_table(runs / "summary.parquet", TABLES["summary"], failed)
    done = quadlog("check", runs, "--expect", bounds, "--junit", tmp_path / "junit.xml")
    assert done.code == 1
    assert "broken: was not replayed: " in done.err
    assert len(list(ET.parse(tmp_path / "junit.xml").getroot().iter("error"))) == 1
    ok("check", runs / "follow", "--expect", bounds)
