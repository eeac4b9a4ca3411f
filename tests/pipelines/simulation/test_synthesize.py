from __future__ import annotations

import json

import numpy as np
import pytest

from quadlog.config.file import load_config
from quadlog.errors import CannotWrite, UnknownName, UsageError
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import ReplayOptions, ReplayRequest
from quadlog.pipelines.simulation.synthesize import make_recording, synthesize
from quadlog.simulation.synthetic import follow


def recording():
    return make_recording("follow", seed=0, duration_s=0.3, azimuth_steps=24)


def test_the_container_is_what_the_extension_or_a_format_says(tmp_path):
    for extension, magic in (("mcap", b"\x89MCAP0"), ("bag", b"#ROSBAG V2.0"), ("db3", b"SQLite format 3")):
        path = tmp_path / f"walk.{extension}"
        assert synthesize(recording(), path)["/lidar/points"] == 3
        assert path.read_bytes().startswith(magic)
    synthesize(recording(), tmp_path / "walk.recording", container="bag")
    assert (tmp_path / "walk.recording").read_bytes().startswith(b"#ROSBAG")
    for name, container, error in (
        ("w.mcap", "bag", UsageError),
        ("w.txt", None, UsageError),
        ("w", "zip", UnknownName),
    ):
        with pytest.raises(error):
            synthesize(recording(), tmp_path / name, container=container)
    with pytest.raises(CannotWrite, match="does not exist"):
        synthesize(recording(), tmp_path / "nowhere" / "walk.mcap")


def test_the_config_says_where_anchors_tags_and_lidar_are(tmp_path):
    config_path = tmp_path / "walk.toml"
    synthesize(recording(), tmp_path / "walk.mcap", config_output=config_path)
    config = load_config(config_path, environ={})
    anchors = [[each.x_m, each.y_m, each.z_m] for each in config.uwb.anchors]
    np.testing.assert_array_equal(anchors, follow.ANCHORS_M)
    assert [(tag.id, tag.role, tag.height_m, tag.x_m) for tag in config.uwb.tags] == [
        (0, "robot", 0.6, -0.2),
        (1, "person", 1.3, 0.0),
    ]
    assert config.lidar.mount.z_m == 0.45
    assert config.topics.reference == "/truth/robot/pose"


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
