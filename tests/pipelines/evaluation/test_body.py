"""The body of a log beside the re-simulated one, in a replay of a walk whose joints are known."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from quadlog.config.file import load_config
from quadlog.messages import GRAVITY_MPS2
from quadlog.metrics.walking import JOINTS, gait
from quadlog.pipelines.evaluation.body import resimulated_body
from quadlog.pipelines.evaluation.metrics import measure_runs
from quadlog.pipelines.evaluation.samples import read_samples
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import ReplayOptions, ReplayRequest
from quadlog.pipelines.simulation.synthesize import synthesize
from quadlog.results.record import read_metrics
from quadlog.results.tables import DUTY_FACTORS, TABLES, read_table, write_table
from quadlog.simulation.synthetic.recording import SynthesizedRecording


@pytest.fixture(scope="module")
def run(walked: SynthesizedRecording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A replay of the walk with the config that `synthesize` writes; not to be changed."""
    folder = tmp_path_factory.mktemp("body")
    synthesize(walked, folder / "walk.mcap", config_output=folder / "walk.toml")
    config = load_config(folder / "walk.toml")
    request = ReplayRequest(folder / "walk.mcap", folder / "run", config, ReplayOptions(), draws=False)
    assert replay(request, Silent()).exit_code == 0
    return folder / "run"


def torques(run: Path, body: str, phase: str) -> tuple[np.ndarray, np.ndarray]:
    """Rms and peak (12,) of body.parquet."""
    table = read_table(run, "body")
    rows = (table["body"] == body) & (table["phase"] == phase)
    assert table["joint"][rows].tolist() == list(JOINTS)
    return table["torque_rms_nm"][rows], table["torque_peak_nm"][rows]


def gait_of(run: Path, body: str) -> dict[str, float]:
    table = read_table(run, "gait")
    (row,) = np.flatnonzero(table["body"] == body)
    return {name: column[row] for name, column in table.items()}


def test_the_logged_body_is_the_one_that_walked(run, walked):
    robot, rows = walked.site.robot.robot, walked.site.robot.rows[:-1]
    true_nm, stands = rows["torques_nm"].astype(float), rows["foot_loads_n"] > 0.0
    rms_nm, peak_nm = torques(run, "logged", "all")
    np.testing.assert_allclose(rms_nm, np.sqrt((true_nm**2).mean(axis=0)), rtol=1e-6)
    np.testing.assert_allclose(peak_nm, np.abs(true_nm).max(axis=0), rtol=1e-6)
    for phase, within in (("stance", stands), ("swing", ~stands)):
        expected = [np.sqrt((true_nm[within[:, joint // 3], joint] ** 2).mean()) for joint in range(12)]
        np.testing.assert_allclose(torques(run, "logged", phase)[0], expected, rtol=0.3)

    walked_gait, moves = gait_of(run, "logged"), np.hypot(*rows["velocity_mps"][:, :2].T) > 0.1
    assert [walked_gait[name] for name in DUTY_FACTORS] == pytest.approx(stands[moves].mean(axis=0), abs=0.05)
    way_m = np.hypot(*np.diff(rows["position_m"][:, :2], axis=0).T).sum()
    energy_j = np.abs(true_nm * rows["joints_radps"]).sum() * 0.002
    true_cost = energy_j / (robot.mass_kg * GRAVITY_MPS2 * way_m)
    assert walked_gait["cost_of_transport"] == pytest.approx(true_cost, rel=0.05)
    assert read_metrics(run)["logged_cost_of_transport"]["value"] == walked_gait["cost_of_transport"]
    assert walked_gait["pitch_mean_rad"] == pytest.approx(rows["rpy_rad"][moves, 1].mean(), abs=0.02)


def test_joints_in_bursts_give_no_gait(run, tmp_path):
    """Messages that waited for one another on the way, a tenth of a second of them at a time."""
    names = ["logged_torque_rms_nm", "logged_duty_factor", "logged_stride_frequency_hz"]
    joints = read_table(run, "joints")
    for name, into_ns in (("jitter", 5_000_000), ("bursts", 100_000_000)):
        (tmp_path / name).mkdir()
        shutil.copy(run / "poses.parquet", tmp_path / name)
        t_ns = joints["t_ns"] // into_ns * into_ns + np.arange(len(joints["t_ns"]))
        write_table(tmp_path / name / "joints.parquet", TABLES["joints"], joints | {"t_ns": t_ns})
    found = {name: read_samples(tmp_path / name, names)[0] for name in ("jitter", "bursts")}
    assert [len(found["jitter"][name].values) > 0 for name in names] == [True, True, True]
    assert [len(found["bursts"][name].values) > 0 for name in names] == [True, False, False]


def test_the_resimulated_body_is_that_of_the_tables_and_metrics(run, walked):
    control, metrics = read_table(run, "control"), read_metrics(run)
    assert not control["fallen"].any()
    true_nm = np.column_stack([control[f"tau_{joint:02d}_nm"] for joint in range(12)])
    rms_nm, peak_nm = torques(run, "resimulated", "all")
    np.testing.assert_allclose(rms_nm, np.sqrt(np.nanmean(true_nm**2, axis=0)))
    np.testing.assert_array_equal(peak_nm, np.nanmax(np.abs(true_nm), axis=0))
    assert metrics["torque_rms_nm"]["value"] == pytest.approx(np.sqrt(np.nanmean(true_nm**2)))
    again = gait_of(run, "resimulated")
    assert again["cost_of_transport"] == metrics["cost_of_transport"]["value"]
    # The same definition as that of the logged body: rows of power over speed.
    body = resimulated_body(run)
    cost = gait(body, walked.site.robot.robot.mass_kg)["cost_of_transport"]
    assert again["cost_of_transport"] == pytest.approx(cost, rel=0.003)
    # Both are walkers of one kind.
    assert again["stride_frequency_hz"] == pytest.approx(gait_of(run, "logged")["stride_frequency_hz"], rel=0.05)
    outcome = measure_runs([run], None, [], in_detail=True)
    assert outcome.problems == []
    for name in ("logged_torque_rms_nm", "logged_torque_max_nm", "logged_duty_factor", "stride_frequency_hz"):
        found = outcome.runs[0].metrics[name]
        assert (found.value, found.n, bool(found.detail)) == (metrics[name]["value"], metrics[name]["n"], True)
