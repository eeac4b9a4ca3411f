from __future__ import annotations

import json

import pytest

from quadlog.config.file import load_config
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import ReplayOptions, ReplayRequest
from quadlog.pipelines.simulation.synthesize import make_recording, synthesize


@pytest.mark.parametrize("scenario", ["forest", "corridor"])
def test_a_replay_finds_the_robot_with_ranges_that_fit(tmp_path, scenario):
    path, config_path = tmp_path / "walk.mcap", tmp_path / "walk.toml"
    synthesize(make_recording(scenario, seed=2, duration_s=30.0, azimuth_steps=24), path, config_output=config_path)
    config = load_config(config_path, environ={})
    outcome = replay(
        ReplayRequest(path, tmp_path / "run", config, ReplayOptions(until="position"), plots=False), Silent()
    )
    assert outcome.exit_code == 0
    record = json.loads((outcome.run / "run.json").read_text())
    assert not [each for each in record["warnings"] if "check [[uwb.anchors]]" in each or "epochs" in each]
    metrics = json.loads((outcome.run / "metrics.json").read_text())
    # In the corridor half of the ranges come through walls, 0.4 m late on average.
    assert metrics["ate_rmse_m"]["value"] < (0.5 if scenario == "corridor" else 0.25)
