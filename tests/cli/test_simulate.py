from __future__ import annotations

import json

import pytest

QUICK = ["--controller", "kinematic", "--set", "pursuit.lookahead_m=0.5", "--no-plots"]


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
    assert not list(tmp_path.rglob("plots"))
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
        (["bend.csv", "--terrain", "9cm"], 2, "9cm"),
        (["bend.csv", "--set", "simulation.controller=none"], 2, "without a controller"),
        (["bend.csv", "--terrain", "3cm", "--set", "simulation.terrain=6cm"], 2, "--terrain 3cm and --set simulation."),
        (["trot-32s", "--controller", "fpm"], 2, "trot-32s takes no"),
        (["trot-32s", "--set", "simulation.trot.payload=1"], 1, "simulation.trot.payload_kg"),
    ],
)
def test_mistakes(path, tmp_path, monkeypatch, refused, arguments, code, says):
    monkeypatch.chdir(tmp_path)
    assert says in refused(code, "simulate", *arguments, "-o", "runs")
    assert not (tmp_path / "runs").exists()
