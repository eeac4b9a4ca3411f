from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from quadlog.cli.main import run
from quadlog.cli.simulate import TERRAINS
from quadlog.cli.simulate import _terrain as option_terrain
from quadlog.config.file import load_config
from quadlog.pipelines.simulation.courses import BANDS_M
from quadlog.results.run.maps import GroundMap, read_ground, write_ground

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
    for flag, value, key in (
        ("--controller", "pmw", "simulation.controller=kinematic"),
        ("--terrain", "3cm", "simulation.terrain=6cm"),
        ("--speed", "0.4", "pursuit.speed_mps=0.5"),
    ):
        assert run(["simulate", str(path), flag, value, "--set", key, *output]) == 2
        assert f"{flag} {value} and --set {key} differ" in capsys.readouterr().err
    assert run(["simulate", "lin", *output]) == 1
    assert "trot-32s" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("name", ["1", "true", "3cm", 'a "b" c', "'", "[x]", "./run", "../run"])
def test_a_run_folder_is_a_terrain_whatever_it_is_called(tmp_path, name, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    Path(name).mkdir()
    for given in (str(Path(name).resolve()), f"./{name}" if name in TERRAINS else name):
        terrain = option_terrain(None, None, given)
        assert Path(load_config(None, [f"simulation.terrain={terrain}"], {}).simulation.terrain).samefile(name)


def test_a_walk_on_a_runs_ground_says_so(path, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "walk").mkdir()
    height_m = np.zeros((5, 60))
    write_ground(tmp_path / "walk", GroundMap(np.array([-5.0, -0.5]), 0.2, height_m, np.full(height_m.shape, 99)))
    (tmp_path / "walk.csv").write_text("0,0\n0,1.5\n")
    assert run(["simulate", "walk.csv", *QUICK, "--terrain", "walk", "-o", "out"]) == 0
    said = capsys.readouterr().err
    record = json.loads((tmp_path / "out" / "walk-kinematic" / "seed-000" / "run.json").read_text())
    assert len(record["notes"]) == len(record["warnings"]) == 1
    assert f"warning: {record['warnings'][0]}" in said
    assert "the ground that walk saw" in said
    assert (
        run(["simulate", "walk.csv", *QUICK, "--terrain", "out/walk-kinematic/seed-000", "-o", "out", "--force"]) == 2
    )
    assert "cannot be the terrain of the walk that replaces it" in capsys.readouterr().err
    assert read_ground(tmp_path / "out" / "walk-kinematic" / "seed-000").cell_m == 0.2


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
    assert set(TERRAINS) == {"flat", *BANDS_M}
