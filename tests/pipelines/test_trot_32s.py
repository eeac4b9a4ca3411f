from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadlog.config.file import load_config
from quadlog.errors import AlreadyExists, InvalidConfigValue
from quadlog.pipelines import simulate as trot_folder
from quadlog.pipelines.executor.progress import Kept, Silent
from quadlog.pipelines.report import rebuild_reports
from quadlog.pipelines.simulate import SimulatedRun, SimulateRequest, simulate
from quadlog.results.record import read_metrics
from quadlog.results.tables import read_table
from quadlog.simulation.robot import trot as trot_walk


def _request(output: Path, *keys: str, **options) -> SimulateRequest:
    config = load_config(None, [f"simulation.trot.{key}" for key in keys], {})
    return SimulateRequest("trot-32s", config, output=output, **options)


@pytest.fixture
def short(monkeypatch) -> None:
    """Three steps, and no plots, which take longer than these."""
    monkeypatch.setattr(trot_walk, "TROT_S", 3.0)
    monkeypatch.setattr(trot_folder, "write_plots", lambda *_: {})


@pytest.fixture(scope="module")
def walked(once) -> list[SimulatedRun]:
    return once("trotted", lambda runs: simulate(_request(runs, "payload_kg=1.2"), 1, Silent()))


def test_there_is_a_run_for_each_curve(walked):
    assert [each.run.parts[-2:] for each in walked] == [("trot-32s", "baseline"), ("trot-32s", "3d-curve")]
    for each in walked:
        names = {entry.name for entry in each.run.iterdir()}
        assert {"run.json", "config.toml", "metrics.json", "control.parquet", "report.html", "plots"} <= names
        metrics = read_metrics(each.run)
        assert {"lateral_drift_m", "yaw_rate_degps", "forward_m", "roll_range_deg", "fallen"} <= set(metrics)
        record = json.loads((each.run / "run.json").read_text())
        assert record["options"] == {"course": "trot-32s", "controller": each.run.name, "seed": 0}
        assert record["config"]["simulation"]["trot"]["payload_kg"] == 1.2
        assert record["recorded_s"] == 32.0


def test_metrics_are_those_of_the_table(walked):
    for each in walked:
        control = read_table(each.run, "control")
        metrics = {name: metric["value"] for name, metric in read_metrics(each.run).items()}
        assert metrics["lateral_drift_m"] == control["y_m"][-1] - control["y_m"][100]
        assert metrics["forward_m"] == control["x_m"][-1] - control["x_m"][100]
        assert metrics["roll_range_deg"] == pytest.approx(np.degrees(np.ptp(control["roll_rad"][100:])))
        assert each.to_dict() == {
            "run": str(each.run),
            "course": "trot-32s",
            "controller": each.run.name,
            "seed": 0,
            **metrics,
        }
        assert np.isnan(control["ref_x_m"]).all()


def test_the_curve_is_the_only_difference(walked):
    first, second = (json.loads((each.run / "run.json").read_text()) for each in walked)
    assert first["config"] == second["config"]
    assert first["input"]["sha256"] != second["input"]["sha256"]
    assert first["notes"][0] == "y(t) has a peak of 0.00 mm"
    assert second["notes"][0] == "y(t) has a peak of 10.01 mm"
    assert first["notes"][1] == second["notes"][1]


def test_the_folder_of_both_has_a_row_for_each_and_a_page(walked):
    folder = walked[0].run.parent
    summary = read_table(folder, "summary")
    assert summary["recording"].tolist() == ["3d-curve", "baseline"]
    assert np.isfinite(summary["lateral_drift_m"]).all()
    assert "3d-curve" in (folder / "report.html").read_text()


def test_the_page_can_be_made_again(walked):
    page = (walked[0].run / "report.html").read_bytes()
    assert b"trot-32s, baseline, seed 0" in page
    assert b"Euler angles" in page
    assert list(rebuild_reports([walked[0].run])) == [walked[0].run / "report.html"]
    assert (walked[0].run / "report.html").read_bytes() == page


def test_the_written_config_gives_the_same_walks(tmp_path, short):
    walked = simulate(_request(tmp_path / "first", "payload_kg=1.2"), 1, Silent())
    config = load_config(walked[0].run / "config.toml", [], {})
    again = simulate(SimulateRequest("trot-32s", config, output=tmp_path / "again"), 1, Silent())
    for before, after in zip(walked, again, strict=True):
        for name in ("control.parquet", "config.toml", "trajectory.tum"):
            assert (after.run / name).read_bytes() == (before.run / name).read_bytes(), name


def test_many_seeds_have_folders_below_the_curves(tmp_path, short):
    runs = simulate(_request(tmp_path, seeds=(4, 5)), 1, Silent())
    assert [str(each.run.relative_to(tmp_path / "trot-32s")) for each in runs] == [
        "baseline/seed-004",
        "baseline/seed-005",
        "3d-curve/seed-004",
        "3d-curve/seed-005",
    ]
    for curve in ("baseline", "3d-curve"):
        summary = read_table(tmp_path / "trot-32s" / curve, "summary")
        assert summary["recording"].tolist() == ["seed-004", "seed-005"]
        assert summary["forward_m"][0] != summary["forward_m"][1]


@pytest.mark.nightly
def test_many_processes_give_the_same_bytes(walked, tmp_path):
    request = _request(tmp_path, "payload_kg=1.2", seeds=(0, 1))
    there = [each for each in simulate(request, 2, Silent()) if each.seed == 0]
    for a, b in zip(walked, there, strict=True):
        assert b.run.parts[-2:] == (a.run.name, "seed-000")
        for name in ("control.parquet", "trajectory.tum", "plots/euler_angles.png"):
            assert (a.run / name).read_bytes() == (b.run / name).read_bytes(), name


def test_nothing_is_overwritten_unless_forced(tmp_path, short):
    request = _request(tmp_path)
    run = simulate(request, 1, Silent())[1].run
    (run / "mine.txt").touch()
    with pytest.raises(AlreadyExists, match="use --force to replace it"):
        simulate(request, 1, Silent())
    simulate(replace(request, force=True), 1, Silent())
    assert (run / "mine.txt").exists()


def test_a_curve_out_of_reach_leaves_nothing_behind(tmp_path):
    with pytest.raises(InvalidConfigValue, match="foot_curve_k"):
        simulate(_request(tmp_path / "runs", "foot_curve_k=1"), 1, Silent())
    assert not (tmp_path / "runs").exists()


def test_a_fall_is_a_result(tmp_path, short):
    progress = Kept()
    runs = simulate(_request(tmp_path, "payload_kg=50", "payload_x_m=0.4"), 1, progress)
    assert all(each.metrics["fallen"]["value"] == 1 for each in runs)
    assert all(each.ended.startswith("fell after ") for each in runs)
    assert any("fell after" in line for line in progress.lines)
    assert json.loads((runs[0].run / "run.json").read_text())["warnings"] == [f"the robot {runs[0].ended}"]
    assert read_table(runs[0].run.parent, "summary")["exit_code"].tolist() == [0, 0]
