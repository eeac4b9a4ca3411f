from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from quadlog.cli.simulate import TERRAINS
from quadlog.cli.simulate import _terrain as option_terrain
from quadlog.config.file import load_config
from quadlog.pipelines.simulation import run_folder as trot_folder
from quadlog.pipelines.simulation.courses import BANDS_M
from quadlog.results.arrays import read_arrays, write_arrays
from quadlog.simulation.robot import trot as trot_walk

QUICK = ["--controller", "kinematic", "--set", "pursuit.lookahead_m=0.5"]


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "bend.csv"
    path.write_text("0,0\n1,0\n1.4,0.3\n")
    return path


def test_prints_a_table_and_where_the_reports_are(path, tmp_path, ok):
    out = ok("simulate", path, *QUICK, "--seeds", "2", "--jobs", "1", "--disturbed", "-o", tmp_path)
    lines = out.splitlines()
    assert lines[0] == f"{tmp_path / 'bend-kinematic'}: bend, kinematic"
    assert lines[2].split() == ["metric", "seed", "0", "seed", "1", "unit"]
    assert sum(line.startswith("eta_m ") for line in lines) == 2, "side by side, and over the seeds"
    assert lines[-2:] == [str(tmp_path / "bend-kinematic" / f"seed-00{seed}" / "report.html") for seed in (0, 1)]


def test_json_is_a_list_of_metrics_and_set_is_stronger_than_disturbed(path, tmp_path, ok):
    settings = ["--disturbed", "--set", "simulation.disturbances.pose_noise_m=0", "--seed", "5", "--speed", "0.4"]
    (row,) = json.loads(ok("simulate", path, *QUICK, *settings, "--json", "-o", tmp_path))
    run = tmp_path / "bend-kinematic" / "seed-005"
    assert (row["seed"], row["run"]) == (5, str(run))
    assert row["completion_time_s"] == pytest.approx(1.4 / 0.4, abs=0.5)
    assert "torque_max_nm" not in row
    disturbances = json.loads((run / "run.json").read_text())["config"]["simulation"]["disturbances"]
    assert (disturbances["pose_noise_m"], disturbances["pose_lag_s"]) == (0.0, 0.1)


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        ([], 2, "COURSE"),
        (["bend.csv", "--controller", "none"], 2, "none"),
        (["bend.csv", "--terrain", "9cm"], 2, "9cm"),
        (["bend.csv", "--seeds", "0"], 2, "--seeds"),
        (["bend.csv", "--set", "simulation.controller=none"], 2, "without a controller"),
        (["bend.csv", "--controller", "pmw", "--set", "simulation.controller=kinematic"], 2, "differ"),
        (["bend.csv", "--terrain", "3cm", "--set", "simulation.terrain=6cm"], 2, "--terrain 3cm and --set simulation."),
        (["bend.csv", "--speed", "0.4", "--set", "pursuit.speed_mps=0.5"], 2, "--speed 0.4 and --set pursuit."),
        (["lin"], 1, "trot-32s"),
        (["trot-32s", "--controller", "fpm"], 2, "trot-32s takes no"),
        (["trot-32s", "--terrain", "3cm"], 2, "trot-32s takes no"),
        (["trot-32s", "--speed", "0.5"], 2, "trot-32s takes no"),
        (["trot-32s", "--disturbed"], 2, "trot-32s takes no"),
        (["trot-32s", "--set", "simulation.trot.payload=1"], 1, "simulation.trot.payload_kg"),
    ],
)
def test_mistakes(path, tmp_path, monkeypatch, refused, arguments, code, says):
    monkeypatch.chdir(tmp_path)
    assert says in refused(code, "simulate", *arguments, "-o", "runs")
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("name", ["1", "true", "3cm", 'a "b" c', "'", "[x]", "./run", "../run"])
def test_a_run_folder_is_a_terrain_whatever_it_is_called(tmp_path, name, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    Path(name).mkdir()
    for given in (str(Path(name).resolve()), f"./{name}" if name in TERRAINS else name):
        terrain = option_terrain(None, None, given)
        assert Path(load_config(None, [f"simulation.terrain={terrain}"], {}).simulation.terrain).samefile(name)


def test_a_walk_on_a_runs_ground_says_so(tmp_path, monkeypatch, quadlog, refused):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "walk").mkdir()
    height_m = np.zeros((5, 60))
    ground = {"origin_m": [-5.0, -0.5], "cell_m": 0.2, "height_m": height_m, "count": np.full(height_m.shape, 99)}
    write_arrays(tmp_path / "walk", "ground", ground)
    (tmp_path / "walk.csv").write_text("0,0\n0,1.5\n")
    done = quadlog("simulate", "walk.csv", *QUICK, "--terrain", "walk", "-o", "out")
    assert done.code == 0
    said = done.err
    record = json.loads((tmp_path / "out" / "walk-kinematic" / "seed-000" / "run.json").read_text())
    assert len(record["notes"]) == len(record["warnings"]) == 1
    assert f"warning: {record['warnings'][0]}" in said
    assert "the ground that walk saw" in said
    itself = ["--terrain", "out/walk-kinematic/seed-000", "-o", "out", "--force"]
    said = refused(2, "simulate", "walk.csv", *QUICK, *itself)
    assert "cannot be the terrain of the walk that replaces it" in said
    assert read_arrays(tmp_path / "out" / "walk-kinematic" / "seed-000", "ground")["cell_m"] == 0.2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0,0\n1,x\n", "line 2"),
        ("0,0\n0,0\n", "two different points"),
        ("0,0\n99,0\n", "gap of 99.0 m"),
        ("", "holds no point"),
    ],
)
def test_a_bad_path_is_one_line_that_says_where(tmp_path, refused, text, said):
    (tmp_path / "bad.csv").write_text(text)
    error = refused(1, "simulate", tmp_path / "bad.csv", *QUICK, "-o", tmp_path)
    assert said in error
    assert "bad.csv" in error


def test_what_is_offered_is_what_there_is():
    assert set(TERRAINS) == {"flat", *BANDS_M}


@pytest.fixture
def short_trot(monkeypatch):
    monkeypatch.setattr(trot_walk, "TROT_S", 2.0)
    monkeypatch.setattr(trot_folder, "write_plots", lambda *_: {})


@pytest.mark.usefixtures("short_trot")
def test_trot_has_a_row_for_each_curve(tmp_path, ok):
    settings = ["--set", "simulation.trot.payload_kg=1.2", "--set", "simulation.trot.payload_y_m=-0.1"]
    settings += ["--seed", "5"]
    rows = json.loads(ok("simulate", "trot-32s", *settings, "--json", "-o", tmp_path))
    assert [row["controller"] for row in rows] == ["baseline", "3d-curve"]
    for row in rows:
        run = tmp_path / "trot-32s" / row["controller"]
        assert (row["run"], row["seed"]) == (str(run), 5)
        saved = json.loads((run / "metrics.json").read_text())
        for name in ("lateral_drift_m", "yaw_rate_degps", "forward_m"):
            assert row[name] == saved[name]["value"]


@pytest.mark.usefixtures("short_trot")
def test_trot_has_a_table_for_each_curve(tmp_path, ok):
    arguments = ["--seeds", "2", "--jobs", "1", "-o", tmp_path]
    lines = ok("simulate", "trot-32s", *arguments).splitlines()
    baseline = tmp_path / "trot-32s" / "baseline"
    assert lines[0] == f"{baseline}: trot-32s, baseline"
    assert any(line.startswith("yaw_rate_degps ") for line in lines)
    assert str(baseline / "seed-000" / "report.html") in lines
    assert f"{tmp_path / 'trot-32s' / '3d-curve'}: trot-32s, 3d-curve" in lines
