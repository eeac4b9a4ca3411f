"""Simulated walks: courses, grounds, controllers and trots into run folders; falls, and what is refused."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadlog.config.file import load_config
from quadlog.errors import InvalidConfigValue, QuadlogError, TooLarge, UnknownName, UnreadableFile, UsageError
from quadlog.pipelines.evaluation.reports import rebuild_reports
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.simulation import trot as trotting
from quadlog.pipelines.simulation.simulate import DISTURBED_OVERRIDES, SimulatedRun, SimulateRequest, simulate
from quadlog.results.diff import diff_runs, of_results
from quadlog.results.record import read_metrics
from quadlog.results.run import load_run
from quadlog.results.tables import read_table
from tests.lab.kept import Kept

KINEMATIC = "simulation.controller=kinematic"


def request_of(course: Path | str, output: Path, *settings: str, **options) -> SimulateRequest:
    config = load_config(None, ["pursuit.lookahead_m=0.6", *settings])
    return SimulateRequest(str(course), config, output=output, **({"plots": False} | options))


def walk(request: SimulateRequest) -> SimulatedRun:
    (run,) = simulate(request, 1, Silent())
    return run


def record_of(run: Path) -> dict:
    return json.loads((run / "run.json").read_text())


@pytest.fixture(scope="session")
def path(once) -> Path:
    """A metre straight on and half a metre aside."""

    def write(folder: Path) -> Path:
        (folder / "bend.csv").write_text("x_m,y_m\n0,0\n1.0,0\n1.4,0.3\n")
        return folder / "bend.csv"

    return once("bend", write)


@pytest.fixture(scope="session")
def walked(path, once) -> SimulatedRun:
    return once("simulated", lambda runs: walk(request_of(path, runs, "simulation.terrain=3cm", plots=True)))


@pytest.fixture
def three_steps(monkeypatch) -> None:
    """Of a trot of 32 s."""
    monkeypatch.setattr(trotting, "TROT_S", 3.0)


@pytest.fixture(scope="session")
def trotted(once) -> list[SimulatedRun]:
    def make(runs: Path) -> list[SimulatedRun]:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(trotting, "TROT_S", 3.0)
            return simulate(request_of("trot-32s", runs, "simulation.trot.payload_kg=1.2", plots=True), 1, Silent())

    return once("trotted", make)


def test_a_run_folder_has_what_the_contract_promises(walked, trotted):
    for run in (walked, *trotted):
        names = {entry.name for entry in run.run.iterdir()}
        files = {"run.json", "config.toml", "metrics.json", "control.parquet", "report.html", "plots"}
        assert files <= names
        metrics = {name: metric["value"] for name, metric in read_metrics(run.run).items()}
        which = {"run": str(run.run), "course": run.course, "controller": run.controller, "seed": 0}
        assert json.loads(json.dumps(run.to_dict(), allow_nan=False)) == which | metrics
        summary = read_table(run.run.parent, "summary")
        assert summary["recording"].tolist() in (["seed-000"], ["3d-curve", "baseline"])
        page = (run.run / "report.html").read_bytes()
        assert b"seed 0" in page
        assert list(rebuild_reports([run.run])) == [run.run / "report.html"]
        assert (run.run / "report.html").read_bytes() == page
    assert walked.run.parts[-2:] == ("bend-fpmw", "seed-000")
    assert {entry.stem for entry in (walked.run / "plots").iterdir()} == {"trajectory", "tracking_error"}
    assert [each.run.parts[-2:] for each in trotted] == [("trot-32s", "baseline"), ("trot-32s", "3d-curve")]


def test_metrics_are_those_of_the_table(walked, trotted):
    control = read_table(walked.run, "control")
    assert np.isnan(control.pop("plan_error_m")).all()  # along a course nothing is planned
    assert np.isnan(control.pop("cmd_vy_mps")).all()  # nor is anything commanded to the side
    stepped = {name for name in control if name.startswith(("wanted_", "us_"))}  # not yet at first
    assert all(np.isfinite(column[name in stepped :]).all() for name, column in control.items())
    metrics = {name: metric["value"] for name, metric in read_metrics(walked.run).items()}
    error_m, cross_m = control["error_m"], control["cross_track_m"]
    by_hand = {"eta_m": error_m.mean(), "sigma_m": error_m.std(ddof=1), "eta_time_m": control["time_error_m"].mean()}
    by_hand |= {"max_error_m": error_m.max(), "cross_track_rmse_m": np.sqrt((cross_m**2).mean())}
    by_hand |= {"completion_time_s": control["t_ns"][-1] * 1e-9}
    apart_n = [control[f"wanted_fz_{leg}_n"] - control[f"fz_{leg}_n"] for leg in range(4)]
    by_hand |= {
        "force_error_rms_n": np.sqrt(np.nanmean(np.square(apart_n))),
        "us_step_median": np.nanmedian(control["us_median"]),
    }
    by_hand |= {"us_step_p95": np.nanpercentile(control["us_max"], 95)}
    assert {name: metrics[name] for name in by_hand} == pytest.approx(by_hand)
    assert by_hand["force_error_rms_n"] < 0.2 * sum(control[f"fz_{leg}_n"].mean() for leg in range(4))
    assert (control["us_median"][1:] <= control["us_max"][1:]).all()
    assert metrics["torque_max_nm"] >= max(np.abs(control[f"tau_{k:02d}_nm"]).max() for k in range(12))
    assert (metrics["fallen"], 0 <= metrics["torque_saturation_share"] < 0.01) == (0, True)
    assert 0.2 < metrics["cost_of_transport"] < 3
    assert (metrics["pitch_rms_rad"] < 0.05, metrics["height_rms_m"] < 0.02) == (True, True)
    counts = record_of(walked.run)["counts"]
    assert (counts["ticks"], counts["mpc_solves"] > 50) == (len(control["t_ns"]), True)
    for each in trotted:
        control = read_table(each.run, "control")
        metrics = {name: metric["value"] for name, metric in read_metrics(each.run).items()}
        assert metrics["lateral_drift_m"] == control["y_m"][-1] - control["y_m"][100]
        assert metrics["forward_m"] == control["x_m"][-1] - control["x_m"][100]
        assert metrics["roll_range_deg"] == pytest.approx(np.degrees(np.ptp(control["roll_rad"][100:])))


def test_the_written_config_gives_the_same_walk(walked, trotted, path, tmp_path, three_steps):
    for course, runs, last in ((str(path), [walked], "derived.mcap"), ("trot-32s", trotted, "trajectory.tum")):
        config = load_config(runs[0].run / "config.toml", [])
        again = simulate(SimulateRequest(course, config, output=tmp_path, plots=False), 1, Silent())
        for before, after in zip(runs, again, strict=True):
            assert len(of_results(diff_runs(load_run(before.run), load_run(after.run)))) == 0
            for name in ("config.toml", last):
                assert (after.run / name).read_bytes() == (before.run / name).read_bytes(), name


@pytest.mark.parametrize("controller", ["fpm", "pmw", "kinematic"])
def test_other_controllers_walk_too(path, tmp_path, controller):
    run = walk(request_of(path, tmp_path, f"simulation.controller={controller}"))
    control = read_table(run.run, "control")
    assert run.metrics["completion_time_s"]["value"] < 6
    is_fuzzy, has_body = controller == "fpm", controller != "kinematic"
    assert np.isfinite(control["k_v"]).any() == is_fuzzy
    assert is_fuzzy or set(control["lookahead_m"]) == {0.6}
    assert ("fallen" in run.metrics) == ("torque_max_nm" in run.metrics) == has_body
    assert ("mpc_solves" in record_of(run.run)["counts"]) == has_body


@pytest.mark.parametrize(("tick_s", "apart_m"), [(0.004, 0.0), (0.002, 0.01), (0.001, 0.01)])
def test_a_walk_with_whole_body_control_is_the_same_by_other_ticks(walked, path, tmp_path, tick_s, apart_m):
    run = walk(request_of(path, tmp_path, "simulation.terrain=3cm", f"simulation.tick_s={tick_s}"))
    columns, others = read_table(walked.run, "control"), read_table(run.run, "control")
    rows = min(len(columns["t_ns"]), len(others["t_ns"]))
    assert abs(len(columns["t_ns"]) - len(others["t_ns"])) <= 2
    for name in ("x_m", "y_m", "z_m"):
        np.testing.assert_allclose(columns[name][:rows], others[name][:rows], rtol=0, atol=apart_m)
    assert (columns["tau_02_nm"][:rows] == others["tau_02_nm"][:rows]).all() == (apart_m == 0)


def test_a_fall_is_a_result(path, tmp_path):
    strong = [f"simulation.disturbances.{name}" for name in ("push_n=2000", "push_every_s=0.5", "push_s=0.3")]
    (run,) = simulate(request_of(path, tmp_path, *strong), 1, progress := Kept())
    assert (run.metrics["fallen"]["value"], "completion_time_s" in run.metrics) == (1, False)
    assert run.ended.startswith("fell after ")
    assert record_of(run.run)["warnings"] == [f"the robot {run.ended}"]
    assert re.search(r"The simulated robot walked .* and fell at", (run.run / "report.html").read_text())
    assert read_table(run.run.parent, "summary")["exit_code"].tolist() == [0]
    assert any("fell after" in line for line in progress.lines)


@pytest.mark.parametrize(
    ("course", "settings", "error"),
    [
        ("bend", ["simulation.friction=0.05", "simulation.terrain=6cm"], QuadlogError),
        ("bend", ["robot.model=spot"], UnknownName),
        ("bend", ["robot.model=nowhere.xml"], UnreadableFile),
        ("bend", ["simulation.controller=none"], UsageError),
        ("long", [], TooLarge),
        ("short", [], UnreadableFile),  # it ends where it begins to be walked
        ("moon", [], UnknownName),
        ("trot-32s", ["simulation.trot.foot_curve_k=1"], InvalidConfigValue),
    ],
)
def test_what_cannot_be_walked_is_refused_before_anything_is_written(path, tmp_path, course, settings, error):
    (tmp_path / "long.csv").write_text("".join(f"{19 * k},0\n" for k in range(10_000)))
    (tmp_path / "short.csv").write_text("0,0\n0.06,0\n0.06,0.04\n")
    courses = {"bend": path, "long": tmp_path / "long.csv", "short": tmp_path / "short.csv"}
    with pytest.raises(error):
        simulate(request_of(courses.get(course, course), tmp_path / "runs", *settings), 1, Silent())
    assert not (tmp_path / "runs").exists()


def test_the_s_curve_brings_its_ground_and_its_speed_unless_given_others(tmp_path):
    run = walk(request_of("s-curve", tmp_path, KINEMATIC))
    assert (run.run / "ground.npz").exists()
    assert record_of(run.run)["config"]["pursuit"]["speed_mps"] == 0.5
    faster = walk(
        request_of("s-curve", tmp_path / "flat", KINEMATIC, "simulation.terrain=flat", "pursuit.speed_mps=0.7")
    )
    assert not (faster.run / "ground.npz").exists()
    assert faster.metrics["completion_time_s"]["value"] < run.metrics["completion_time_s"]["value"]


@pytest.mark.nightly
def test_seeds_draw_their_own_ground_and_many_processes_give_the_same(path, tmp_path):
    request = request_of(path, tmp_path / "one", "simulation.terrain=6cm", *DISTURBED_OVERRIDES, seeds=(3, 4))
    one = simulate(request, 1, Silent())
    two = simulate(replace(request, output=tmp_path / "two"), 2, Silent())
    for name in ("control.parquet", "ground.npz"):
        files = [(each.run / name).read_bytes() for each in (*one, *two)]
        assert files[:2] == files[2:]
        assert files[0] != files[1]


def test_seeds_of_a_trot_have_folders_below_its_curves_and_the_curve_is_the_only_difference(tmp_path, three_steps):
    runs = simulate(request_of("trot-32s", tmp_path, seeds=(4, 5)), 1, Silent())
    assert [str(each.run.relative_to(tmp_path / "trot-32s")) for each in runs] == [
        f"{curve}/seed-00{seed}" for curve in trotting.CURVES for seed in (4, 5)
    ]
    records = [record_of(each.run) for each in (runs[0], runs[2])]
    assert records[0]["config"] == records[1]["config"]
    assert [record["notes"][0] for record in records] == ["y(t) has a peak of 0.00 mm", "y(t) has a peak of 10.01 mm"]
    assert records[0]["input"]["sha256"] != records[1]["input"]["sha256"]
    forward_m = read_table(tmp_path / "trot-32s" / "baseline", "summary")["forward_m"]
    assert forward_m[0] != forward_m[1]


def trotted_by(aside_m: float) -> dict[str, float]:
    """Metrics of the robot as it is planned, whose feet swing that far to the left."""
    model = trotting.trot_model(trotting.TrotRobot())
    walked = trotting.walk_trot(model, trotting.joint_targets(np.full(4, aside_m)), np.zeros(12))
    return {name: each.value for name, each in trotting.trot_metrics(walked).items()}


def test_a_symmetric_robot_goes_straight_rolls_as_the_paper_has_it_and_turns_by_a_trim():
    """0.06 degrees a second for each millimetre of trim, as facts about another model of this robot have it."""
    metrics = trotted_by(0.0)
    assert abs(metrics["yaw_rate_degps"]) <= 0.005
    assert (6 <= metrics["roll_range_deg"] <= 8, metrics["fallen"]) == (True, 0)
    assert abs(metrics["lateral_drift_m"]) < 0.02
    assert 2.3 < metrics["forward_m"] < 2.7  # without slip it is 2 S T, and on what it does not rest on
    assert abs(trotted_by(0.005)["yaw_rate_degps"]) == pytest.approx(5 * 0.06, rel=0.2)
