"""Height, roll and pitch of poses, from every source that knows them; errors in 2-D and 3-D, with evo as the oracle."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.config.file import load_config
from quadlog.config.schema import Config
from quadlog.geometry import seconds_since
from quadlog.messages import UwbRanges
from quadlog.pipelines.evaluation.metrics import measure_runs
from quadlog.pipelines.evaluation.reference import OnTime, Reference
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import ReplayOptions, ReplayOutcome, ReplayRequest
from quadlog.pipelines.simulation.synthesize import write_recording
from quadlog.results.tables import read_table
from quadlog.simulation.synthetic import forest
from quadlog.simulation.synthetic.forest import ANCHORS_M
from quadlog.simulation.synthetic.recording import IMU_TOPIC, START_NS, TF_STATIC_TOPIC, UWB_TOPIC
from quadlog.storage.formats.tum import read_tum, write_tum_poses
from tests.pipelines.evaluation.test_reference import by_evo as of_evo


def by_evo(run: Path, *, planar: bool) -> list[float]:
    """rmse of ATE and RPE of trajectory.tum against reference.tum."""
    return list(of_evo(run / "reference.tum", run, OnTime(planar=planar)).values())


def replayed(lias_site: Any, folder: Path, quat_xyzw: Any, position_m: Any, t_ns: Any) -> ReplayOutcome:
    """A real walk whose poses come from a file, against the recording's motion capture."""
    write_tum_poses(folder / "poses.tum", t_ns, position_m, quat_xyzw)
    config = load_config(None, [f"topics.position={folder / 'poses.tum'}"])
    options = ReplayOptions(until="position", duration_s=12.0)
    request = ReplayRequest(lias_site.folder / "lias_fast.mcap", folder / "run", config, options, plots=False)
    return replay(request, Silent())


@pytest.mark.parametrize("planar", [False, True])
def test_errors_are_those_of_evo_in_space_and_in_the_plane(lias_site, tmp_path, planar):
    truth, rng = read_tum(lias_site.folder / "lias_fast_mocap.tum"), np.random.default_rng(0)
    position_m = truth.position_m + rng.normal(0, [0.02, 0.02, 0.2], truth.position_m.shape)
    turned = Rotation.from_quat(truth.quat_xyzw) * Rotation.from_rotvec(rng.normal(0, 0.1, position_m.shape))
    if planar:
        position_m[:, 2] = 0
    outcome = replayed(lias_site, tmp_path, turned.as_quat(), position_m, truth.t_ns)
    poses, back = read_table(outcome.run, "poses"), read_tum(outcome.run / "trajectory.tum")
    np.testing.assert_allclose(
        np.column_stack([poses[name] for name in ("yaw_rad", "pitch_rad", "roll_rad")]), turned.as_euler("ZYX")
    )
    np.testing.assert_allclose(back.position_m, position_m)
    np.testing.assert_allclose((Rotation.from_quat(back.quat_xyzw) * turned.inv()).magnitude(), 0, atol=1e-9)
    found = [outcome.metrics[name]["value"] for name in ("ate_rmse_m", "rpe_rmse_m")]
    assert found == pytest.approx(by_evo(outcome.run, planar=planar), abs=1e-9)
    words = "2-D (the poses lie in a plane)" if planar else "3-D"
    notes = " ".join(json.loads((outcome.run / "run.json").read_text())["notes"])
    assert f"the reference: errors in {words}; " in notes or f"errors against the reference are in {words}" in notes
    told = measure_runs([outcome.run], Reference.read(outcome.run / "reference.tum", OnTime()), []).said
    assert f"errors in {'3-D (the poses lie in a plane; heights that are not' if planar else '3-D;'}" in told[1]


@pytest.mark.parametrize(("n_tags", "height_m"), [(1, 0.6), (2, 0.6), (1, None)])
def test_heights_that_uwb_solves_and_the_tilt_of_the_imu_are_those_of_the_walk(tmp_path, n_tags, height_m):
    """Synthetic, over rough ground between anchors of several heights; base is on the ground. Tag 7 repeats tag 0."""
    walk, path = forest.synthesize(3, 12.0, azimuth_steps=8), tmp_path / "walk.mcap"
    topics = {UWB_TOPIC, IMU_TOPIC, TF_STATIC_TOPIC, "/truth/robot/pose"}
    messages = [each for each in walk.messages() if each.topic in topics]
    messages += [
        each._replace(message=replace(each.message, tag=7))
        for each in messages
        if isinstance(each.message, UwbRanges) and each.message.tag == 0
    ]
    write_recording(path, sorted(messages, key=lambda each: each.log_time_ns))
    anchors = [dict(zip(("id", "x_m", "y_m", "z_m"), (i, *at), strict=True)) for i, at in enumerate(ANCHORS_M.tolist())]
    tags = [{"id": tag, "role": "robot", "height_m": height_m, "x_m": -0.2} for tag in (0, 7)[:n_tags]]
    config = Config.model_validate({"uwb": {"anchors": anchors, "tags": tags, "height": "solved"}})
    outcome = replay(
        ReplayRequest(path, tmp_path / "run", config, ReplayOptions(until="position"), plots=False), Silent()
    )
    poses = read_table(outcome.run, "poses")
    truth = walk.site.robot.at(seconds_since(poses["t_ns"], START_NS))
    np.testing.assert_allclose(poses["roll_rad"], truth.roll_rad, atol=1e-6)
    np.testing.assert_allclose(poses["pitch_rad"], truth.pitch_rad, atol=1e-6)
    # Biases of links look like heights: 0.45 m rms over four seeds. A copy of a tag repeats its errors: 0.59 m.
    assert np.sqrt(np.mean((poses["z_m"] - truth.height_m) ** 2)) < (0.5 if n_tags == 1 else 0.65)
    found = [outcome.metrics[name]["value"] for name in ("ate_rmse_m", "rpe_rmse_m")]
    # Where nobody gave the tag's height, base's is not known: errors are those in the plane.
    assert found == pytest.approx(by_evo(outcome.run, planar=height_m is None), abs=1e-9)
