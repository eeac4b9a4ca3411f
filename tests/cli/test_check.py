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
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.results.check import bounds_toml, propose
from quadlog.results.run import SavedMetric
from tests.cli.conftest import FIXTURES


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


def test_json_and_junit_say_the_same(follow, bounds, tmp_path, quadlog):
    bounds.write_text("[default]\nuwb_rmse_m = { max = 0.0 }\nuwb_residual_m = { min = 0 }\n")
    junit = tmp_path / "out" / "report.xml"
    done = quadlog("check", follow, "--expect", bounds, "--json", "--junit", junit)
    assert done.code == 4
    (content,) = json.loads(done.out)
    (suite,) = ET.parse(junit).getroot()
    assert {each["metric"]: each["holds"] for each in content["bounds"]} == {
        case.get("name"): case.find("failure") is None for case in suite
    }
    assert quadlog("check", follow, "--expect", bounds, "--write", "--json").code == 2
    assert quadlog("check", follow, "--expect", bounds, "--junit", junit).code == 1
    assert quadlog("check", follow, "--expect", bounds, "--junit", junit, "--force").code == 4
    before = bounds.read_text()
    assert quadlog("check", follow, "--expect", bounds, "--junit", bounds, "--force").code == 2
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
    assert set(found) == set(CATALOGUE) - {"realtime_factor"}
    sides = {"lower": {"max"}, "higher": {"min"}, "": {"min", "max"}}
    assert {name: set(bound) for name, bound in found.items()} == {
        name: sides[CATALOGUE[name].better] for name in found
    }
    assert "of_another_version" in quadlog("check", run, "--expect", tmp_path / "x.toml", "--write").err
    values = {"eta_m": 0.2, "clearance_min_m": -0.5, "expanded_total": 2628, "yaw_rate_degps": -2.0, "success_rate": 1}
    values |= {"suboptimality_mean": 0.0, "fallen": 0, "collisions": 3, "sigma_m": 6.7e-16}
    assert proposed(measured(tmp_path / "run", follow, **values), quadlog) == {
        "eta_m": {"max": 0.22}, "clearance_min_m": {"min": -0.55}, "expanded_total": {"max": 2900.0},
        "yaw_rate_degps": {"min": -2.2, "max": -1.8}, "success_rate": {"min": 0.99},
        "suboptimality_mean": {"max": 0.01}, "fallen": {"max": 0.0}, "collisions": {"max": 3.0},
        "sigma_m": {"max": 0.000101},  # rounded outwards
    }  # fmt: skip


VALUES = st.floats(allow_nan=False, allow_infinity=False)
METRICS = st.dictionaries(st.sampled_from(sorted(CATALOGUE)), st.tuples(VALUES, VALUES), max_size=8)


@given(METRICS)
def test_what_was_written_is_read_and_holds_on_the_runs_it_was_written_from(tmp_path_factory, metrics):
    path = tmp_path_factory.mktemp("bounds") / "bounds.toml"
    runs = [{name: SavedMetric(both[at]) for name, both in metrics.items()} for at in (0, 1)]
    record = SimpleNamespace(options={})
    made = [SimpleNamespace(path=Path('a.b "c"'), simulated=False, record=record, metrics=each) for each in runs]
    path.write_bytes(bounds_toml(propose(made), path))
    bounds = read_bounds(path)[made[0].path.name]
    assert set(bounds) == set(metrics) - {"realtime_factor"}
    assert all(bound.holds(value) for name, bound in bounds.items() for value in metrics[name])


def test_a_written_file_is_not_replaced_without_force(follow, tmp_path, quadlog, ok, refused):
    path = tmp_path / "ci" / "bounds.toml"
    ok("check", follow, "--expect", path, "--write")
    ok("check", follow, "--expect", path)
    path.write_text(path.read_text().replace("[recordings.follow]", "[recordings.other]"))
    done = quadlog("check", follow, "--expect", path)
    assert done.code == 4
    assert "add [recordings.follow] or [default]" in done.out
    assert done.err == "not checked, no such run was given: other\n"
    assert "--force" in refused(1, "check", follow, "--expect", path, "--write")
    assert "[recordings.other]" in path.read_text()
    ok("check", follow, "--expect", path, "--write", "--force")
    assert "[recordings.other]" not in path.read_text()


def test_a_bound_under_a_name_replaces_that_of_all_and_none_removes_it(follow, bounds, quadlog, ok):
    bounds.write_text("[default]\nuwb_residual_m = { max = 0 }\n[recordings.follow]\nuwb_residual_m = {}\n")
    assert "no bounds are expected" in quadlog("check", follow, "--expect", bounds).out
    bounds.write_text("[default]\nuwb_residual_m = { max = 0 }\n[recordings.follow.uwb_residual_m]\nmax = 9\n")
    ok("check", follow, "--expect", bounds)


def test_a_walk_goes_by_its_course_and_by_its_seed(follow, tmp_path, bounds, quadlog, ok):
    seed = shutil.copytree(follow, tmp_path / "line-fpmw" / "seed-003")
    record = json.loads((seed / "run.json").read_text())
    (seed / "run.json").write_text(json.dumps(record | {"options": {"course": "line"}}))
    for name in ("line-fpmw", '"line-fpmw/seed-003"'):
        bounds.write_text(f"[recordings.{name}]\nuwb_residual_m = {{ max = 10 }}\n")
        ok("check", tmp_path / "line-fpmw", "--expect", bounds)
    bounds.write_text("[recordings.seed-003]\nuwb_residual_m = { max = 10 }\n")
    assert quadlog("check", seed, "--expect", bounds).code == 4
    (seed / "metrics.json").write_text("[]")
    done = quadlog("check", tmp_path / "line-fpmw", "--expect", bounds)
    assert (done.code, done.out.splitlines()[0]) == (1, f"{seed}: cannot be checked")
    assert done.err.endswith(f"quadlog: {seed}/metrics.json: is damaged: no JSON object\n")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[default]\neta = { max = 1 }", "unknown key default.eta; did you mean default.eta_m?"),
        ("[recordings.x]\neta_m = { maxi = 1 }", "unknown key recordings.x.eta_m.maxi; did you mean"),
        ("[default]\neta_m = { min = 2, max = 1 }", "default.eta_m: min must not be above max"),
        ("[default]\neta_m = {}", "default.eta_m: needs min, max or both"),
        ("[default]\neta_m = { max = nan }", "default.eta_m.max: input should be a finite number"),
        ("[recording.x]", "unknown key recording; did you mean recordings?"),
        ("recordings.x = 1", "recordings.x: is a table"),
        (f"[default]\neta_m = {{ max = {'9' * 5000} }}", "not TOML"),
        ("[default", "not TOML"),
    ],
)
def test_a_bad_file_of_bounds_is_one_line(follow, bounds, refused, text, says):
    bounds.write_text(text)
    assert says in refused(1, "check", follow, "--expect", bounds)


def test_a_recording_without_a_run_is_no_success(bounds, tmp_path, quadlog, ok):
    (tmp_path / "season").mkdir()
    shutil.copy(FIXTURES / "follow.mcap", tmp_path / "season" / "follow.mcap")
    (tmp_path / "season" / "broken.bag").write_text("no bag")
    runs = tmp_path / "runs"
    what = ["--until", "position", "--duration", "0.5", "--jobs", "1", "--no-plots"]
    assert quadlog("replay", tmp_path / "season", "-c", FIXTURES / "follow.toml", "-o", runs, *what).code == 3
    done = quadlog("check", runs, "--expect", bounds, "--junit", tmp_path / "junit.xml")
    assert done.code == 1
    assert "broken: was not replayed: " in done.err
    assert len(list(ET.parse(tmp_path / "junit.xml").getroot().iter("error"))) == 1
    ok("check", runs / "follow", "--expect", bounds)
    done = quadlog("metrics", runs)
    assert (done.code, "broken: was not replayed: " in done.err) == (3, True)
    assert quadlog("metrics", runs, "--fail-if", "uwb_rmse_m>1e9").code == 4


def test_bounds_that_accept_a_fall_or_contact_are_named_and_commented(follow, tmp_path, quadlog):
    copy, path = shutil.copytree(follow, tmp_path / "follow"), tmp_path / "bounds.toml"
    for value, events in ((0, 0), (2, 2)):
        measured(copy, follow, fallen=value, collisions=value, eta_m=value)
        done = quadlog("check", copy, "--expect", path, "--write", "--force")
        assert (done.code, done.out) == (0, f"{path}: 3 bounds for follow\n")
        assert done.err.startswith("warning: the bounds for follow accept ") is (events > 0)
        assert ("a fall (fallen)" in done.err, "(collisions)" in done.err) == (events > 0, events > 0)
        assert path.read_text().count(" # accepts ") == events
        assert quadlog("check", copy, "--expect", path).code == 0
