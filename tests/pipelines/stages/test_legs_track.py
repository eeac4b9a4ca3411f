"""Logs that tell the robot's position by its legs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from quadlog.config.file import load_config
from quadlog.errors import MissingInput
from quadlog.geometry import seconds_since
from quadlog.messages import UwbRanges
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import ReplayOptions, ReplayOutcome, ReplayRequest
from quadlog.pipelines.simulation.synthesize import WRITERS, recording_config, write_recording
from quadlog.pipelines.survey import survey_recording
from quadlog.results.tables import read_table
from quadlog.simulation.synthetic.recording import (
    IMU_TOPIC,
    JOINT_TOPIC,
    LIDAR_TOPIC,
    ODOMETRY_TOPIC,
    ROBOT_TAG,
    ROBOT_TRUTH_TOPIC,
    START_NS,
    TF_STATIC_TOPIC,
    UWB_TOPIC,
    SynthesizedMessage,
    SynthesizedRecording,
)

MODEL = "robot.model=tracking"


@pytest.fixture(scope="module")
def messages(walked) -> list[SynthesizedMessage]:
    return list(walked.messages())


def replayed(
    folder: Path, messages: list[SynthesizedMessage], topics: set[str], *overrides: str, until: str = "position"
) -> ReplayOutcome:
    """A replay of those messages that are on some topics."""
    recording = folder / "walk.mcap"
    write_recording(WRITERS["mcap"](recording), (each for each in messages if each.topic in topics))
    file = next(folder.glob("*.toml"), None)
    config, options = load_config(file, list(overrides), {}), ReplayOptions(until=until)
    request = ReplayRequest(recording, folder / "run", config, options, plots=False)
    return replay(request, Silent())


def furthest_off_m(run: Path, walked: SynthesizedRecording) -> float:
    """Of the poses from the true ones, both in the frame of the first one."""
    poses = read_table(run, "poses", ["t_ns", "x_m", "y_m", "yaw_rad", "source"])
    assert set(poses["source"]) == {"legs"}
    motion = walked.site.robot.at(seconds_since(poses["t_ns"], START_NS))
    cos, sin = np.cos(motion.yaw_rad[0]), np.sin(motion.yaw_rad[0])
    x_m, y_m = (motion.position_m - motion.position_m[0]).T
    return float(np.hypot(poses["x_m"] - (cos * x_m + sin * y_m), poses["y_m"] - (cos * y_m - sin * x_m)).max())


def said(outcome: ReplayOutcome) -> str:
    record = json.loads((outcome.run / "run.json").read_text())
    return "\n".join([*record["warnings"], *record["notes"]])


def test_joints_and_an_imu_tell_where_the_robot_was_and_nothing_more(tmp_path, walked, messages):
    outcome = replayed(tmp_path, messages, {JOINT_TOPIC, IMU_TOPIC}, until="report")
    assert outcome.exit_code == 0
    # 8 m; the IMU's yaw is known to 0.1 degrees, and drifts by 0.3.
    assert furthest_off_m(outcome.run, walked) < 0.12
    assert not (outcome.run / "scans.parquet").exists()
    assert "stopped after position" in said(outcome)
    assert "leg lengths of 'tracking' are assumed" in said(outcome)
    joints = read_table(outcome.run, "joints", ["contact_1", "foot_force_1_n"])
    standing, swinging = (
        joints["contact_1"][each] for each in (joints["foot_force_1_n"] > 50, joints["foot_force_1_n"] == 0)
    )
    assert np.median(standing) > 0.8
    assert np.median(swinging) < 0.1


def test_with_a_lidar_legs_place_the_map_and_no_scan_is_matched(tmp_path, walked, messages, monkeypatch):
    monkeypatch.setattr("quadlog.positioning.lidar_odometry.LidarOdometry.take", None)
    topics = {JOINT_TOPIC, IMU_TOPIC, LIDAR_TOPIC, TF_STATIC_TOPIC}
    outcome = replayed(tmp_path, messages, topics, MODEL, until="map")
    assert furthest_off_m(outcome.run, walked) < 0.12
    assert (outcome.run / "maps.npz").exists()
    assert "are assumed" not in said(outcome)
    assert "move against the ground" not in said(outcome)


def test_legs_can_be_chosen_before_odometry_and_ranges(tmp_path, walked, messages):
    (tmp_path / "site.toml").write_text(recording_config(walked))
    topics = {JOINT_TOPIC, IMU_TOPIC, ODOMETRY_TOPIC, UWB_TOPIC, ROBOT_TRUTH_TOPIC}
    outcome = replayed(tmp_path, messages, topics, "topics.position=legs")
    assert furthest_off_m(outcome.run, walked) < 0.12


def test_a_person_in_the_anchors_frame_is_no_target_of_a_robot_in_its_own(tmp_path, walked, messages):
    (tmp_path / "site.toml").write_text(recording_config(walked))
    of_person = [
        each for each in messages if not (isinstance(each.message, UwbRanges) and each.message.tag == ROBOT_TAG)
    ]
    outcome = replayed(tmp_path, of_person, {JOINT_TOPIC, IMU_TOPIC, UWB_TOPIC, ROBOT_TRUTH_TOPIC})
    assert set(read_table(outcome.run, "poses", ["source"])["source"]) == {"legs"}
    assert set(read_table(outcome.run, "target", ["source"])["source"]) == {"ahead"}


def test_legs_of_another_robot_are_seen_to_slip(tmp_path, messages):
    other = replayed(tmp_path, messages, {JOINT_TOPIC, IMU_TOPIC}, "robot.model=b1")
    assert "feet that carry move against the ground" in said(other)
    assert "lengths and hips are those of 'b1'" in said(other)


def test_without_joints_legs_cannot_be_chosen(tmp_path, messages):
    with pytest.raises(MissingInput, match=r"topics.position = 'legs'"):
        replayed(tmp_path, messages, {ODOMETRY_TOPIC}, "topics.position=legs")


def test_legs_steady_a_track_of_ranges(tmp_path, walked, messages):
    (tmp_path / "site.toml").write_text(recording_config(walked))
    outcome = replayed(tmp_path, messages, {JOINT_TOPIC, IMU_TOPIC, UWB_TOPIC, ROBOT_TRUTH_TOPIC})
    assert set(read_table(outcome.run, "poses", ["source"])["source"]) == {"uwb"}
    assert "velocities by legs steady its track" in said(outcome)


def without(messages: list[SynthesizedMessage], first_s: float, last_s: float) -> Iterator[SynthesizedMessage]:
    for each in messages:
        if not (each.topic == JOINT_TOPIC and first_s < (each.log_time_ns - START_NS) * 1e-9 < last_s):
            yield each


def test_a_gap_and_a_missing_imu_are_told(tmp_path, messages):
    outcome = replayed(tmp_path, list(without(messages, 4.0, 4.5)), {JOINT_TOPIC}, MODEL)
    assert "joints are silent for up to 0.5 s; meanwhile the robot is taken to stand" in said(outcome)
    assert "no foot stands" not in said(outcome)
    assert "there is no IMU; yaw comes from the feet alone" in said(outcome)


def test_a_short_gap_is_told_to_be_bridged(tmp_path, messages):
    outcome = replayed(tmp_path, list(without(messages, 4.0, 4.2)), {JOINT_TOPIC, IMU_TOPIC}, MODEL)
    assert "joints are silent for up to 0.2 s; meanwhile the last speed is taken" in said(outcome)


def test_joints_too_seldom_to_tell_a_motion_are_told(tmp_path, messages):
    joints = [each for each in messages if each.topic == JOINT_TOPIC][::100]
    outcome = replayed(tmp_path, joints, {JOINT_TOPIC}, MODEL)
    assert "joints come every 0.2 s, too seldom to measure motion; the robot is taken to stand" in said(outcome)


def test_anchors_are_surveyed_along_the_way_of_the_legs(tmp_path, walked, messages):
    """Twelve seconds show little: the bounds have to say so, and hold."""
    recording = tmp_path / "walk.mcap"
    topics = {JOINT_TOPIC, IMU_TOPIC, UWB_TOPIC}
    write_recording(WRITERS["mcap"](recording), (each for each in messages if each.topic in topics))
    (tmp_path / "c.toml").write_text('[[uwb.tags]]\nid = 0\nrole = "robot"\nx_m = -0.2\ny_m = 0.0\nheight_m = 0.6\n')
    config = load_config(tmp_path / "c.toml", [MODEL], {})
    found = survey_recording(recording, config, ReplayOptions(), {None: 1.2}, Silent())
    assert found.source == "legs"
    start = walked.site.robot.at(np.array([(found.start_ns - START_NS) * 1e-9]))
    off = (walked.site.anchors_m[:, :2] - start.position_m[0]) @ [1, 1j] * np.exp(-1j * start.yaw_rad[0])
    assert [each.why_not for each in found.survey.anchors] == [""] * 4
    error_m = [each.position_m[:2] - [off[each.index].real, off[each.index].imag] for each in found.survey.anchors]
    assert (np.abs(error_m) <= [each.bound_m[:2] for each in found.survey.anchors]).all()
    assert np.hypot(*np.transpose(error_m)).max() <= 0.6
