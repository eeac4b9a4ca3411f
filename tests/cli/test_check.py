from __future__ import annotations

import json
import shutil
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

FIXTURES = Path(__file__).parents[2] / "fixtures"


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
    assert "absent" in verdicts["eta_m"]
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
    assert quadlog("check", follow, "--expect", bounds, "--junit", junit).code == 1
    assert quadlog("check", follow, "--expect", bounds, "--junit", junit, "--force").code == 4
    before = bounds.read_text()
    assert quadlog("check", follow, "--expect", bounds, "--junit", bounds, "--force").code == 2
    assert bounds.read_text() == before


def test_proposed_bounds_hold_and_keep_what_was_there(follow, tmp_path, quadlog, ok, refused):
    path = tmp_path / "ci" / "bounds.toml"
    ok("check", follow, "--expect", path, "--write")
    ok("check", follow, "--expect", path)
    path.write_text("# mine\n" + path.read_text().replace("[recordings.follow]", "[recordings.other]"))
    done = quadlog("check", follow, "--expect", path)
    assert done.code == 4
    assert "add [recordings.follow] or [default]" in done.out
    assert done.err == "not checked, no such run was given: other\n"
    assert "--force" in refused(1, "check", follow, "--expect", path, "--write")
    ok("check", follow, "--expect", path, "--write", "--force")
    assert path.read_text().startswith("# mine\n")
    assert {"[recordings.other]", "[recordings.follow]"} <= set(path.read_text().splitlines())
    ok("check", follow, "--expect", path)


def test_a_broken_run_in_a_folder_of_runs_is_an_error(follow, bounds, tmp_path, quadlog):
    folder = tmp_path / "runs"
    for name in ("follow", "broken"):
        shutil.copytree(follow, folder / name)
    (folder / "broken" / "metrics.json").write_text("[]")
    done = quadlog("check", folder, "--expect", bounds, "--junit", tmp_path / "report.xml")
    assert done.code == 1
    assert done.out.splitlines()[:2] == [f"{folder}/broken: cannot be checked", f"{folder}/follow: all bounds hold"]
    assert done.err == f"quadlog: {folder}/broken/metrics.json: is damaged: no JSON object\n"
    assert [suite.get("errors") for suite in ET.parse(tmp_path / "report.xml").getroot()] == ["1", "0"]


def test_a_bad_file_of_bounds_is_one_line_and_kept(follow, bounds, refused):
    text = "[default]\neta = { max = 1 }"
    bounds.write_text(text)
    for more in ([], ["--write", "--force"]):
        assert "unknown key default.eta; did you mean eta_m?" in refused(1, "check", follow, "--expect", bounds, *more)
    assert bounds.read_text() == text


def test_a_metric_of_the_runs_own_may_be_bounded(follow, bounds, tmp_path, quadlog):
    copy = shutil.copytree(follow, tmp_path / "follow")
    metrics = json.loads((copy / "metrics.json").read_text())
    metrics["my_own_m"] = {"value": 1.0, "n": 1, "unit": "m"}
    (copy / "metrics.json").write_text(json.dumps(metrics))
    bounds.write_text("[default]\nmy_own_m = { max = 0.5 }\n")
    assert quadlog("check", copy, "--expect", bounds).code == 4
    assert quadlog("check", follow, "--expect", bounds).code == 1


def test_usage(follow, bounds, tmp_path, refused):
    refused(2, "check", follow)
    refused(2, "check", "--expect", bounds)
    refused(2, "check", follow, "--expect", bounds, "--write", "--junit", tmp_path / "x.xml")
    refused(2, "check", follow, "--expect", bounds, "--write", "--json")
    refused(1, "check", tmp_path / "nothing", "--expect", bounds)
    refused(1, "check", follow, "--expect", tmp_path / "nothing.toml")


def test_a_recording_without_a_run_is_no_success(bounds, tmp_path, quadlog, ok):
    (tmp_path / "season").mkdir()
    shutil.copy(FIXTURES / "follow.mcap", tmp_path / "season" / "follow.mcap")
    (tmp_path / "season" / "broken.bag").write_text("no bag")
    runs = tmp_path / "runs"
    what = [
        "-c",
        FIXTURES / "follow.toml",
        "-o",
        runs,
        "--until",
        "position",
        "--duration",
        "0.5",
        "--jobs",
        "1",
        "--no-plots",
    ]
    assert quadlog("replay", tmp_path / "season", *what).code == 3
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
        metrics = {name: {"value": value, "n": 9, "unit": ""} for name in ("fallen", "collisions", "eta_m")}
        (copy / "metrics.json").write_text(json.dumps(metrics))
        done = quadlog("check", copy, "--expect", path, "--write", "--force")
        assert (done.code, done.out) == (0, f"{path}: 3 bounds for follow\n")
        assert done.err.startswith("warning: the bounds for follow accept ") is (events > 0)
        assert ("a fall (fallen)" in done.err, "(collisions)" in done.err) == (events > 0, events > 0)
        assert path.read_text().count(" # accepts ") == events
        assert quadlog("check", copy, "--expect", path).code == 0
