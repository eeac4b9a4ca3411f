from __future__ import annotations

import json

import pytest

from quadlog.cli.main import run
from quadlog.pipelines.simulation import run_folder as trot_folder
from quadlog.simulation.robot import trot as trot_walk


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(trot_walk, "TROT_S", 2.0)
    monkeypatch.setattr(trot_folder, "write_plots", lambda *_: {})


QUICK = ["--set", "results.frames=0"]


def test_json_has_a_row_for_each_curve(tmp_path, capsys):
    settings = ["--set", "simulation.trot.payload_kg=1.2", "--set", "simulation.trot.payload_y_m=-0.1"]
    assert run(["simulate", "trot-32s", *QUICK, *settings, "--seed", "5", "--json", "-o", str(tmp_path)]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["controller"] for row in rows] == ["baseline", "3d-curve"]
    for row in rows:
        assert row["run"] == str(tmp_path / "trot-32s" / row["controller"])
        assert row["seed"] == 5
        saved = json.loads((tmp_path / "trot-32s" / row["controller"] / "metrics.json").read_text())
        for name in ("lateral_drift_m", "yaw_rate_degps", "forward_m"):
            assert row[name] == saved[name]["value"]


def test_text_has_a_table_for_each_curve(tmp_path, capsys):
    assert run(["simulate", "trot-32s", *QUICK, "--seeds", "2", "--jobs", "1", "-o", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"{tmp_path / 'trot-32s' / 'baseline'}: trot-32s, baseline"
    assert "yaw deg/s" in lines[1]
    assert [line.split()[0] for line in lines[2:6]] == ["0", "1", "mean", "std"]
    assert lines[6] == str(tmp_path / "trot-32s" / "baseline" / "seed-000" / "report.html")
    assert f"{tmp_path / 'trot-32s' / '3d-curve'}: trot-32s, 3d-curve" in lines


@pytest.mark.parametrize("option", [["--controller", "fpm"], ["--terrain", "3cm"], ["--speed", "0.5"], ["--disturbed"]])
def test_options_that_mean_nothing_to_it_are_refused(tmp_path, capsys, option):
    assert run(["simulate", "trot-32s", *option, "-o", str(tmp_path / "runs")]) == 2
    assert "trot-32s takes no" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_a_wrong_key_is_one_line_with_the_nearest(tmp_path, capsys):
    assert run(["simulate", "trot-32s", "--set", "simulation.trot.payload=1", "-o", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "simulation.trot.payload_kg" in error


def test_help_says_where_its_runs_go(capsys):
    assert run(["simulate", "--help"]) == 0
    assert "trot-32s/3d-curve" in "".join(capsys.readouterr().out.split())
