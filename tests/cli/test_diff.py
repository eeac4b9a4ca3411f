from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from quadlog.cli.main import run

FIXTURES = Path(__file__).parents[2] / "fixtures"


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A run, one that says it had another seed, and one that sees less of the same seconds."""
    folder = tmp_path_factory.mktemp("out")
    recording = [str(FIXTURES / "follow.mcap"), "-c", str(FIXTURES / "follow.toml"), "--until", "map"]
    for name, more in (("a", []), ("other", ["--set", "grid.min_height_m=0.3"])):
        assert run(["replay", *recording, "--duration", "0.5", "-o", str(folder / name), *more]) == 0
    same = shutil.copytree(folder / "a" / "follow", folder / "same" / "follow")
    record = json.loads((same / "run.json").read_text())
    (same / "run.json").write_text(json.dumps(record | {"seed": 3}))
    return folder


def diff(runs, a, b, *more):
    return run(["diff", str(runs / a / "follow"), str(runs / b / "follow"), *more])


def test_two_runs_of_one_recording_are_the_same_whatever_else_is_listed(runs, capsys):
    capsys.readouterr()
    assert diff(runs, "a", "same") == 0
    out, err = capsys.readouterr()
    assert err == ""
    lines = out.splitlines()
    assert lines[2] == "results: the same"
    assert lines[lines.index("seed: differs") + 1] == "    seed  0 | 3 (by 3)"
    assert {"position: the same", "map: the same", "plan: nothing saved"} <= set(lines)


def test_a_difference_is_found_in_its_stage_and_followed(runs, capsys):
    capsys.readouterr()
    assert diff(runs, "a", "other") == 4
    lines = capsys.readouterr().out.splitlines()
    assert lines[2].startswith("results: differ, first in stage map: maps.npz, cells at 0.000 s (t_ns 17672256")
    assert "    grid.min_height_m  0.05 | 0.3 (by 0.25)" in lines
    assert "filter: the same" in lines
    (cells,) = [line for line in lines if line.startswith("        cells")]
    assert "5 rows, the first at 0.000 s" in cells
    assert " | " in cells
    assert "at most " in cells


def test_json_has_all_of_it(runs, capsys):
    capsys.readouterr()
    assert diff(runs, "a", "other", "--json") == 4
    content = json.loads(capsys.readouterr().out)
    assert not content["same"]
    assert content["first"]["stage"] == "map"
    assert content["first"]["place"] == {"t_ns": content["start_ns"], "s": 0.0, "keys": {}}
    assert content["origins"]["config"] == [{"key": "grid.min_height_m", "a": 0.05, "b": 0.3, "apart": 0.25}]
    results = {each["name"]: each for each in content["stages"]["map"]}
    assert results["maps.npz"]["columns"][0]["rows"] == 5
    assert [each["same"] for each in content["stages"]["filter"]] == [True, True]


def test_a_tolerance_forgives_what_is_within(runs, tmp_path, capsys):
    copy = tmp_path / "follow"
    shutil.copytree(runs / "a" / "follow", copy)
    metrics = json.loads((copy / "metrics.json").read_text())
    metrics["uwb_residual_m"]["value"] += 1e-6
    (copy / "metrics.json").write_text(json.dumps(metrics))
    arguments = ["diff", str(runs / "a" / "follow"), str(copy)]
    assert run(arguments) == 4
    assert run([*arguments, "--tolerance", "2e-6"]) == 0
    assert run([*arguments, "--relative", "1e-9"]) == 4
    assert run([*arguments, "--relative", "1e-4"]) == 0


@pytest.mark.parametrize("flag", ["--tolerance", "--relative"])
@pytest.mark.parametrize("value", ["-1", "nan", "inf", "x"])
def test_a_tolerance_is_a_finite_amount(runs, flag, value, capsys):
    assert diff(runs, "a", "same", flag, value) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_what_is_no_run_or_damaged_is_named_in_one_line(runs, tmp_path, capsys):
    capsys.readouterr()
    assert diff(runs, "a", "nothing") == 1
    assert run(["diff", str(runs / "a"), str(runs / "same" / "follow")]) == 1
    copy = shutil.copytree(runs / "a" / "follow", tmp_path / "follow")
    (copy / "scans.parquet").write_bytes(b"PAR1")
    assert run(["diff", str(copy), str(runs / "a" / "follow"), "--json"]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert [line.startswith("quadlog: ") for line in err.splitlines()] == [True] * 3
    assert "scans.parquet" in err.splitlines()[2]


def test_names_from_a_recording_cannot_command_the_terminal(runs, tmp_path, capsys):
    copy = shutil.copytree(runs / "a" / "follow", tmp_path / "follow")
    record = json.loads((copy / "run.json").read_text())
    record["topics"][0]["topic"] = "/\x1b[31mred\nline"
    (copy / "run.json").write_text(json.dumps(record))
    capsys.readouterr()
    assert run(["diff", str(copy), str(runs / "a" / "follow")]) == 4
    out = capsys.readouterr().out
    assert "\x1b" not in out
    assert "red line" in out
