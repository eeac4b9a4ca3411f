"""Logs that tell the robot's position by the lidar alone, and logs that have no lidar."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from quadlog.config.file import load_config
from quadlog.errors import MissingInput
from quadlog.geometry import seconds_since
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayOutcome, ReplayRequest
from quadlog.pipelines.simulation.synthesize import WRITERS, write_recording
from quadlog.positioning.lidar_odometry import LidarOdometry
from quadlog.results.tables import read_table
from quadlog.simulation.synthetic import follow
from quadlog.simulation.synthetic.recording import (
    IMU_TOPIC,
    LIDAR_TOPIC,
    ODOMETRY_TOPIC,
    START_NS,
    TF_STATIC_TOPIC,
    UWB_TOPIC,
    SynthesizedRecording,
)


@pytest.fixture(scope="module")
def walk() -> SynthesizedRecording:
    return follow.synthesize(31, 5.0, azimuth_steps=300)


def replayed(
    folder: Path,
    walk: SynthesizedRecording,
    topics: set[str],
    *overrides: str,
    until: str = "report",
    existing: Existing = Existing.REFUSE,
) -> ReplayOutcome:
    """A replay of those messages of the walk that are on some topics."""
    recording = folder / "walk.mcap"
    if not recording.exists():
        write_recording(WRITERS["mcap"](recording), (each for each in walk.messages() if each.topic in topics))
    config = load_config(None, list(overrides), {})
    options = ReplayOptions(until=until)
    return replay(ReplayRequest(recording, folder / "run", config, options, existing, plots=False), Silent())


@pytest.mark.parametrize("until", ["position", "map"])
def test_without_other_sources_the_lidar_tells_where_the_robot_was(tmp_path, walk, until):
    replayed(tmp_path, walk, {TF_STATIC_TOPIC, LIDAR_TOPIC, IMU_TOPIC}, until=until)
    poses = read_table(tmp_path / "run", "poses", ["t_ns", "x_m", "y_m", "yaw_rad", "source"])
    assert set(poses["source"]) == {"lidar"}
    motion = walk.site.robot.at(seconds_since(poses["t_ns"], START_NS))
    # Both in the frame of the first pose.
    cos, sin = np.cos(motion.yaw_rad[0]), np.sin(motion.yaw_rad[0])
    x_m, y_m = (motion.position_m - motion.position_m[0]).T
    error_m = np.hypot(poses["x_m"] - (cos * x_m + sin * y_m), poses["y_m"] - (cos * y_m - sin * x_m))
    turned = (poses["yaw_rad"] - (motion.yaw_rad - motion.yaw_rad[0]) + np.pi) % (2 * np.pi) - np.pi
    assert error_m.max() < 0.1
    assert np.abs(turned).max() < 0.03
    assert len(poses["t_ns"]) == 50


def test_scans_are_not_matched_where_an_odometry_tells_the_position(tmp_path, walk, monkeypatch):
    monkeypatch.setattr("quadlog.positioning.lidar_odometry.LidarOdometry.take", None)
    outcome = replayed(tmp_path, walk, {TF_STATIC_TOPIC, LIDAR_TOPIC, ODOMETRY_TOPIC}, until="position")
    assert outcome.exit_code == 0


def test_an_odometry_goes_before_the_lidar_unless_chosen_otherwise(tmp_path, walk):
    topics = {TF_STATIC_TOPIC, LIDAR_TOPIC, IMU_TOPIC, ODOMETRY_TOPIC}
    sources = {}
    for chosen in ("auto", "lidar"):
        (tmp_path / chosen).mkdir()
        replayed(tmp_path / chosen, walk, topics, f"topics.position={chosen}", until="position")
        sources[chosen] = set(read_table(tmp_path / chosen / "run", "poses", ["source"])["source"])
    assert sources == {"auto": {"odometry"}, "lidar": {"lidar"}}


@pytest.mark.parametrize(
    ("override", "source", "other"),
    [("lidar.odometry=true", "uwb", "lidar"), ("topics.position=lidar", "lidar", "uwb")],
)
def test_lidar_and_uwb_are_compared_where_both_are_tracked(tmp_path, walk, override, source, other):
    topics = {TF_STATIC_TOPIC, LIDAR_TOPIC, IMU_TOPIC, UWB_TOPIC}
    rows = enumerate(walk.site.anchors_m.tolist())
    anchors = ", ".join(f"{{id={i}, x_m={x_m}, y_m={y_m}, z_m={z_m}}}" for i, (x_m, y_m, z_m) in rows)
    outcome = replayed(tmp_path, walk, topics, f"uwb.anchors=[{anchors}]", override, until="position")
    saved = [set(read_table(tmp_path / "run", name, ["source"])["source"]) for name in ("poses", "other_poses")]
    assert saved == [{source}, {other}]
    assert outcome.metrics["lidar_uwb_rmse_m"]["value"] < 0.15
    assert any(
        "velocities by lidar steady its track" in note
        for note in json.loads((tmp_path / "run" / "run.json").read_text())["notes"]
    )


def test_a_lidar_that_is_not_there_cannot_be_chosen(tmp_path, walk):
    with pytest.raises(MissingInput, match=r"topics\.position = 'lidar'"):
        replayed(tmp_path, walk, {IMU_TOPIC}, "topics.position=lidar")


def test_without_a_lidar_a_replay_ends_after_position_and_says_so(tmp_path, walk):
    topics = {ODOMETRY_TOPIC, UWB_TOPIC, IMU_TOPIC}
    outcome = replayed(tmp_path, walk, topics)
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    assert outcome.exit_code == 0
    assert [stage["name"] for stage in record["stages"]] == ["ingest", "position", "report"]
    (why,) = [text for text in record["warnings"] if "lidar" in text]
    assert why == "stopped after position: no topic is fit to be the lidar"
    assert (tmp_path / "run" / "report.html").is_file()
    again = replayed(tmp_path, walk, topics, existing=Existing.RESUME)
    assert len(again.reused) == 6
    with pytest.raises(MissingInput, match="no topic is fit to be the lidar"):
        replayed(tmp_path, walk, topics, until="map", existing=Existing.FORCE)
    assert json.loads((tmp_path / "run" / "run.json").read_text()) == record


@pytest.mark.parametrize(("name", "poses", "within_m"), [("lidarme", 485, 0.1), ("anlam_hallway", 881, 17.0)])
def test_real_planar_scans_are_matched_without_a_loss(tmp_path, name, poses, within_m):
    """A scanner that stands, and one that is carried along a hallway: along its walls a match must not slide."""
    recording = Path(os.environ.get("QUADLOG_DATASETS", "")) / "other_robots" / f"{name}.bag"
    if not recording.exists():
        pytest.skip(f"{recording} is not there")
    options = ReplayOptions(until="position")
    outcome = replay(ReplayRequest(recording, tmp_path / "run", load_config(None, [], {}), options), Silent())
    found = read_table(tmp_path / "run", "poses", ["t_ns", "x_m", "y_m"])
    assert outcome.exit_code == 0
    assert len(found["t_ns"]) == poses
    assert np.hypot(found["x_m"], found["y_m"]).max() < within_m


def test_where_the_lidar_was_tried_and_failed_the_message_says_why(tmp_path, walk):
    """From nearer than any return on, no scan has points to match."""
    topics, few = {TF_STATIC_TOPIC, LIDAR_TOPIC}, ("lidar.min_range_m=28", "lidar.max_range_m=29")
    outcome = replayed(tmp_path, walk, topics, *few, until="position")
    assert outcome.exit_code == 3
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    (why,) = [text for text in record["warnings"] if "origin" in text]
    assert "lidar: 50 of 50 scans have fewer than" in why
    assert record["losses"][0]["detail"].startswith("100% of")
    with pytest.raises(MissingInput, match="50 of 50 scans"):
        replayed(tmp_path, walk, topics, *few, "topics.position=lidar", until="position", existing=Existing.FORCE)


def test_a_scan_that_was_lost_is_in_no_map(tmp_path, walk, monkeypatch):
    take = LidarOdometry.take

    def blind(self: LidarOdometry, t_ns: int, xyz_m: np.ndarray, offset_ns: np.ndarray | None) -> None:
        """Six of fifty scans, one at a time, have nothing to match."""
        take(self, t_ns, xyz_m[: 5 if len(self) % 8 == 7 else None], offset_ns)

    monkeypatch.setattr(LidarOdometry, "take", blind)
    topics = {TF_STATIC_TOPIC, LIDAR_TOPIC, IMU_TOPIC}
    outcome = replayed(tmp_path, walk, topics, "lidar.deskew=false", until="map")
    assert outcome.exit_code == 3
    assert json.loads((tmp_path / "run" / "run.json").read_text())["counts"]["scans_without_pose"] == 6
    assert len(read_table(tmp_path / "run", "poses", ["t_ns"])["t_ns"]) == 44
    again = replayed(tmp_path, walk, topics, "lidar.deskew=false", until="map", existing=Existing.RESUME)
    assert again.exit_code == 3
