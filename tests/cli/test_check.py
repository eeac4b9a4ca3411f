from __future__ import annotations

import json
import shutil
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from quadlog.cli.main import run

FIXTURES = Path(__file__).parents[2] / "fixtures"


@pytest.fixture(scope="module")
def follow(tmp_path_factory):
    folder = tmp_path_factory.mktemp("out") / "runs"
    arguments = [str(FIXTURES / "follow.mcap"), "-c", str(FIXTURES / "follow.toml"), "-o", str(folder)]
    assert run(["replay", *arguments, "--until", "map", "--duration", "0.5"]) == 0
    return folder / "follow"


@pytest.fixture
def bounds(tmp_path):
    path = tmp_path / "bounds.toml"
    path.write_text("[recordings.follow]\nuwb_residual_m = { max = 10 }\n")
    return path


def check(*arguments):
    return run(["check", *map(str, arguments)])


def test_bounds_that_hold_and_one_that_does_not(follow, bounds, capsys):
    capsys.readouterr()
    assert check(follow, "--expect", bounds) == 0
    out, err = capsys.readouterr()
    assert (out.splitlines()[0], err) == (f"{follow}: all bounds hold", "")
    with bounds.open("a") as file:
        file.write("[default]\nuwb_rmse_m = { max = 0.0 }\neta_m = { max = 1 }\n")
    assert check(follow, "--expect", bounds) == 4
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"{follow}: 2 of 3 bounds do not hold"
    verdicts = {line.split()[0]: line for line in lines[1:]}
    assert "absent" in verdicts["eta_m"]
    assert verdicts["uwb_rmse_m"].endswith("DOES NOT HOLD")
    assert verdicts["uwb_residual_m"].endswith("holds")


def test_json_and_junit_say_the_same(follow, bounds, tmp_path, capsys):
    capsys.readouterr()
    bounds.write_text("[default]\nuwb_rmse_m = { max = 0.0 }\nuwb_residual_m = { min = 0 }\n")
    junit = tmp_path / "out" / "report.xml"
    assert check(follow, "--expect", bounds, "--json", "--junit", junit) == 4
    (content,) = json.loads(capsys.readouterr().out)
    (suite,) = ET.parse(junit).getroot()
    assert {each["metric"]: each["holds"] for each in content["bounds"]} == {
        case.get("name"): case.find("failure") is None for case in suite
    }
    assert check(follow, "--expect", bounds, "--junit", junit) == 1
    assert "--force" in capsys.readouterr().err
    assert check(follow, "--expect", bounds, "--junit", junit, "--force") == 4


def test_proposed_bounds_hold_and_keep_what_was_there(follow, tmp_path, capsys):
    path = tmp_path / "ci" / "bounds.toml"
    assert check(follow, "--expect", path, "--write") == 0
    assert check(follow, "--expect", path) == 0
    path.write_text("# mine\n" + path.read_text().replace("[recordings.follow]", "[recordings.other]"))
    capsys.readouterr()
    assert check(follow, "--expect", path) == 4  # nothing is expected of it
    out, err = capsys.readouterr()
    assert "no bounds are expected of this run; add [recordings.follow] or [default]" in out
    assert err == "not checked, no such run was given: other\n"
    assert check(follow, "--expect", path, "--write") == 1
    assert check(follow, "--expect", path, "--write", "--force") == 0
    assert path.read_text().startswith("# mine\n")
    assert {"[recordings.other]", "[recordings.follow]"} <= set(path.read_text().splitlines())
    assert check(follow, "--expect", path) == 0


def test_a_folder_of_runs_is_all_of_them_and_a_broken_one_is_an_error(follow, bounds, tmp_path, capsys):
    folder = tmp_path / "runs"
    shutil.copytree(follow, folder / "follow")
    shutil.copytree(follow, folder / "broken")
    (folder / "broken" / "metrics.json").write_text("[]")
    capsys.readouterr()
    junit = tmp_path / "report.xml"
    assert check(folder, "--expect", bounds, "--junit", junit) == 1
    out, err = capsys.readouterr()
    assert out.splitlines()[:2] == [f"{folder}/broken: cannot be checked", f"{folder}/follow: all bounds hold"]
    assert err.splitlines() == [f"quadlog: {folder}/broken/metrics.json: is damaged: no JSON object"]
    assert [suite.get("errors") for suite in ET.parse(junit).getroot()] == ["1", "0"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[default]\neta = { max = 1 }", "unknown key default.eta; did you mean eta_m?"),
        ("[default]\neta_m = { max = nan }", "default.eta_m.max: is a finite number"),
        ("[default", "not TOML"),
    ],
)
def test_a_bad_file_of_bounds_is_one_line(follow, bounds, text, said, capsys):
    bounds.write_text(text)
    capsys.readouterr()
    for more in ([], ["--write", "--force"]):
        assert check(follow, "--expect", bounds, *more) == 1
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("\n") == 1
        assert said in err
    assert bounds.read_text() == text


def test_a_metric_of_the_runs_own_may_be_bounded(follow, bounds, tmp_path):
    copy = shutil.copytree(follow, tmp_path / "follow")
    metrics = json.loads((copy / "metrics.json").read_text())
    metrics["my_own_m"] = {"value": 1.0, "n": 1, "unit": "m"}
    (copy / "metrics.json").write_text(json.dumps(metrics))
    bounds.write_text("[default]\nmy_own_m = { max = 0.5 }\n")
    assert check(copy, "--expect", bounds) == 4
    assert check(follow, "--expect", bounds) == 1


def test_usage(follow, bounds, tmp_path, capsys):
    assert check(follow) == 2
    assert check("--expect", bounds) == 2
    assert check(follow, "--expect", bounds, "--write", "--junit", tmp_path / "x.xml") == 2
    assert check(follow, "--expect", bounds, "--write", "--json") == 2
    assert check(tmp_path / "nothing", "--expect", bounds) == 1
    assert check(follow, "--expect", tmp_path / "nothing.toml") == 1
    assert "Traceback" not in capsys.readouterr().err


def test_a_recording_without_a_run_is_no_success(follow, bounds, tmp_path, capsys):
    (tmp_path / "season").mkdir()
    shutil.copy(FIXTURES / "follow.mcap", tmp_path / "season" / "follow.mcap")
    (tmp_path / "season" / "broken.bag").write_text("no bag")
    config = str(FIXTURES / "follow.toml")
    what = ["-c", config, "-o", str(tmp_path / "runs"), "--until", "position", "--duration", "0.5", "--jobs", "1"]
    assert run(["replay", str(tmp_path / "season"), *what]) == 3
    capsys.readouterr()
    assert check(tmp_path / "runs", "--expect", bounds, "--junit", tmp_path / "junit.xml") == 1
    assert "broken: was not replayed: not a recording" in capsys.readouterr().err
    assert len(list(ET.parse(tmp_path / "junit.xml").getroot().iter("error"))) == 1
    assert check(tmp_path / "runs" / "follow", "--expect", bounds) == 0
    assert run(["metrics", str(tmp_path / "runs")]) == 3
    assert "broken: was not replayed: not a recording" in capsys.readouterr().err
    assert run(["metrics", str(tmp_path / "runs"), "--fail-if", "uwb_rmse_m>1e9"]) == 4


def test_bounds_are_not_replaced_by_what_they_found(follow, bounds):
    before = bounds.read_text()
    assert check(follow, "--expect", bounds, "--junit", bounds, "--force") == 2
    assert bounds.read_text() == before
