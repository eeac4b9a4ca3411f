from __future__ import annotations

import json

import pytest

from quadlog.cli.main import run
from quadlog.cli.simulate import CONTROLLERS, TERRAINS
from quadlog.config_control import Simulation
from quadlog.pipelines.simulation.where import BANDS_M

QUICK = ["--controller", "kinematic", "--set", "pursuit.lookahead_m=0.5"]


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "bend.csv"
    path.write_text("0,0\n1,0\n1.4,0.3\n")
    return path


def test_prints_a_table_and_where_the_reports_are(path, tmp_path, capsys):
    assert run(["simulate", str(path), *QUICK, "--seeds", "2", "--jobs", "1", "--disturbed", "-o", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    lines = out.splitlines()
    assert lines[0] == f"{tmp_path / 'bend-kinematic'}: bend, kinematic"
    assert [line.split()[0] for line in lines[2:6]] == ["0", "1", "mean", "std"]
    assert lines[6:] == [str(tmp_path / "bend-kinematic" / f"seed-00{seed}" / "report.html") for seed in (0, 1)]


def test_json_is_a_list_of_metrics_and_nothing_else(path, tmp_path, capsys):
    assert run(["simulate", str(path), *QUICK, "--seed", "5", "--speed", "0.4", "--json", "-o", str(tmp_path)]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["seed"] == 5
    assert row["run"] == str(tmp_path / "bend-kinematic" / "seed-005")
    assert row["completion_time_s"] == pytest.approx(1.4 / 0.4, abs=0.3)
    assert "torque_max_nm" not in row


def test_set_is_stronger_than_disturbed(path, tmp_path):
    settings = ["--disturbed", "--set", "simulation.disturbances.pose_noise_m=0"]
    assert run(["simulate", str(path), *QUICK, *settings, "-o", str(tmp_path)]) == 0
    disturbances = json.loads((tmp_path / "bend-kinematic" / "seed-000" / "run.json").read_text())["config"][
        "simulation"
    ]["disturbances"]
    assert (disturbances["pose_noise_m"], disturbances["pose_lag_s"]) == (0.0, 0.1)


def test_usage_errors_exit_with_2(path, tmp_path, capsys):
    output = ["-o", str(tmp_path / "runs")]
    assert run(["simulate"]) == 2
    assert run(["simulate", str(path), "--controller", "none", *output]) == 2
    assert run(["simulate", str(path), "--terrain", "9cm", *output]) == 2
    assert run(["simulate", str(path), "--seeds", "0", *output]) == 2
    assert run(["simulate", str(path), "--set", "simulation.controller=none", *output]) == 2
    capsys.readouterr()
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0,0\n1,x\n", "line 2"),
        ("0,0\n0,0\n", "two different points"),
        ("0,0\n99,0\n", "gap of 99.0 m"),
        ("", "holds no point"),
    ],
)
def test_a_bad_path_is_one_line_that_says_where(tmp_path, capsys, text, said):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    assert run(["simulate", str(path), *QUICK, "-o", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error
    assert "bad.csv" in error


def test_what_is_offered_is_what_there_is():
    assert {*CONTROLLERS, "none"} == set(Simulation.model_fields["controller"].annotation.__args__)
    assert set(TERRAINS) == {"flat", *BANDS_M}
