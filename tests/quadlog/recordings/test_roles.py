from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadlog.config.schema import Topics
from quadlog.errors import AmbiguousTopic, UnknownTopic
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders import ros_messages
from quadlog.recordings.recording import Recording, open_recording
from quadlog.recordings.roles import Roles, detect_roles

T0 = 1_700_000_000 * 10**9
SPHERE = np.random.default_rng(0).normal(size=(500, 3))
FLAT = SPHERE * [1, 1, 0]


def roles_of(log: Any, **topics: Any) -> Roles:
    return detect_roles(Recording(log.container), Topics(**topics))


def test_one_topic_for_each_role(log: Any) -> None:
    log.add("/points", T0, log.ros.cloud(T0, SPHERE))
    log.add("/odom", T0, log.ros.odometry(T0, 0.0))
    log.add("/uwb/n_0/n_2", T0, log.ros.range(T0, 1.0))
    log.add("/uwb/n_0/n_3", T0, log.ros.range(T0, 1.0))
    log.add("/tf", T0, log.ros.tf())
    roles = roles_of(log)
    assert roles.topic("lidar") == "/points"
    assert roles.topic("odometry") == "/odom"
    assert roles.topics("uwb") == ("/uwb/n_0/n_2", "/uwb/n_0/n_3")
    assert roles.topics("tf") == ("/tf",)
    assert roles.topic("reference") is None
    assert roles.of_topic("/points") == ("lidar", "500 points per scan in 3-D")


def test_a_flat_scan_and_a_radar_give_way_to_a_lidar(log: Any) -> None:
    log.add("/flat", T0, log.ros.cloud(T0, FLAT))
    log.add("/points", T0, log.ros.cloud(T0, SPHERE))
    log.add("/radar", T0, log.ros.cloud(T0, SPHERE))
    log.add("/few", T0, log.ros.cloud(T0, SPHERE[:20]))
    roles = roles_of(log)
    assert roles.topic("lidar") == "/points"
    assert "2-D" in roles.unused["/flat"]
    assert "radar" in roles.unused["/radar"]
    assert "only 20 points" in roles.unused["/few"]


def test_a_lidar_that_starts_late_is_one(log: Any) -> None:
    for k in range(12):
        log.add("/points", T0 + k, log.ros.cloud(T0 + k, SPHERE if k > 8 else np.full((500, 3), np.nan)))
    roles = roles_of(log)
    assert roles.of_topic("/points") == ("lidar", "starts with empty scans")
    log.add("/few", T0, log.ros.cloud(T0, SPHERE[:20]))
    with pytest.raises(AmbiguousTopic, match=r"topics\.lidar=/few  or  --set topics\.lidar=/points"):
        roles_of(log).topic("lidar")
    log.add("/other", T0, log.ros.cloud(T0, SPHERE))
    assert roles_of(log).topic("lidar") == "/other"


def test_a_topic_that_never_shows_anything_is_no_lidar(log: Any) -> None:
    for k in range(12):
        log.add("/points", T0 + k, log.ros.cloud(T0 + k, np.zeros((500, 3))))
    assert roles_of(log).topic("lidar") is None
    assert "/points its first scans are empty" in roles_of(log).why_none("lidar")


def test_ambiguity_lists_flags_to_paste_only_when_the_role_is_needed(log: Any) -> None:
    log.add("/left", T0, log.ros.cloud(T0, SPHERE))
    log.add("/right", T0, log.ros.cloud(T0, 2 * SPHERE))
    log.add("/odom", T0, log.ros.odometry(T0, 0.0))
    roles = roles_of(log)
    assert roles.topic("odometry") == "/odom"
    with pytest.raises(AmbiguousTopic, match=r"--set topics\.lidar=/left  or  --set topics\.lidar=/right"):
        roles.topic("lidar")
    assert roles_of(log, lidar="/right").topic("lidar") == "/right"


def test_truth_is_a_reference_and_no_odometry(log: Any) -> None:
    log.add("/odom", T0, log.ros.odometry(T0, 0.0))
    log.add("/ground_truth/odom", T0, log.ros.odometry(T0, 0.0))
    roles = roles_of(log)
    assert roles.topic("odometry") == "/odom"
    assert roles.topic("reference") == "/ground_truth/odom"


@pytest.mark.parametrize(
    ("topic", "is_truth"),
    [
        *((name, True) for name in ("/pose_gt", "/robot/gtPose", "/vrpn_client_node/go2/pose", "/leica/pose")),
        *((name, True) for name in ("/Vicon/base", "/mocap4r2/pose", "/base_pose_ground_truth", "/motion_capture/rig")),
        *((name, False) for name in ("/gtsam/pose", "/locomotive/pose", "/vicon/error", "/amcl_pose", "/slam/pose")),
    ],
)
def test_a_pose_is_true_only_if_its_name_says_so(log: Any, topic: str, is_truth: bool) -> None:
    add_pose(log, topic)
    assert roles_of(log).topic("reference") == (topic if is_truth else None)
    assert roles_of(log, reference="none").topic("reference") is None
    assert roles_of(log, reference=topic).topic("reference") == topic


def test_poses_of_estimators_are_listed_and_wanted_ones_are_not(log: Any) -> None:
    for topic in ("/amcl_pose", "/orb_slam3/pose", "/mocap/robot", "/goal_pose", "/mpc/reference", "/tracking_error"):
        add_pose(log, topic)
    log.add("/mpc/desired", T0, log.ros.odometry(T0, 0.0))
    log.add("/odom", T0, log.ros.odometry(T0, 0.0))
    roles = roles_of(log)
    assert roles.topics("pose") == ("/amcl_pose", "/orb_slam3/pose")
    assert roles.topic("odometry") == "/odom"
    assert "--set topics.odometry=/mpc/desired" in roles.unused["/mpc/desired"]


def add_pose(log: Any, topic: str) -> None:
    kind = log.ros.type("geometry_msgs/msg/PoseStamped")
    log.add(topic, T0, kind(log.ros.header(T0), log.ros.pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))))


def test_the_position_is_not_its_own_truth(log: Any) -> None:
    add_pose(log, "/mocap/robot")
    assert roles_of(log).topic("reference") == "/mocap/robot"
    for source in ("position", "odometry"):
        roles = roles_of(log, **{source: "/mocap/robot"})
        assert roles.topic(source) == "/mocap/robot"
        assert roles.topic("reference") is None
        with pytest.raises(UnknownTopic, match=f"reference: /mocap/robot is topics.{source}"):
            roles_of(log, reference="/mocap/robot", **{source: "/mocap/robot"})


def test_a_pose_file_or_a_source_by_name_is_no_topic(log: Any) -> None:
    add_pose(log, "/mocap/robot")
    for position in ("truth.tum", "tf", "auto"):
        assert roles_of(log, position=position).topic("reference") == "/mocap/robot"


def test_a_better_truth_than_the_position_is_the_reference(log: Any) -> None:
    add_pose(log, "/amcl_pose")
    add_pose(log, "/mocap/robot")
    assert roles_of(log, position="/amcl_pose").topic("reference") == "/mocap/robot"
    # And what is worse than the position is no truth for it.
    assert roles_of(log, position="/mocap/robot").topic("reference") is None


def test_another_body_is_not_taken_for_the_truth_of_the_position(log: Any) -> None:
    add_pose(log, "/mocap/person")
    add_pose(log, "/mocap/robot")
    roles = roles_of(log, position="/mocap/robot")
    with pytest.raises(AmbiguousTopic, match=r"--set topics\.reference=/mocap/person"):
        roles.topic("reference")
    assert roles_of(log, position="/mocap/robot", reference="/mocap/person").topic("reference") == "/mocap/person"


def test_a_configured_position_is_a_pose(log: Any) -> None:
    log.add("/points", T0, log.ros.cloud(T0, SPHERE))
    with pytest.raises(UnknownTopic, match="/points is sensor_msgs/msg/PointCloud2, not a pose"):
        roles_of(log, position="/points")


def test_several_kinds_of_ranges_are_one_flag_each(log: Any) -> None:
    for anchor in (1, 2):
        log.add(f"/uwb/n_0/n_{anchor}", T0, log.ros.range(T0, 1.0))
    log.container.add(Channel("/gtec", "gtec_msgs/msg/Ranging", "cdr", "", b""), T0, b"")
    roles = roles_of(log)
    family = """--set 'topics.uwb=["/uwb/n_0/n_1", "/uwb/n_0/n_2"]'"""
    with pytest.raises(AmbiguousTopic) as raised:
        roles.topics("uwb")
    assert str(raised.value) == (
        f"2 groups of topics could be the uwb; choose with  --set topics.uwb=/gtec  or  {family}"
    )
    assert roles.of_topic("/uwb/n_0/n_2") == (None, f"one of 2 that could be the uwb: {family}")


@pytest.mark.parametrize("role", ["odometry", "imu", "reference", "lidar"])
def test_a_choice_is_explained_in_one_line(log: Any, role: str) -> None:
    kinds = {"odometry": "nav_msgs/msg/Odometry", "imu": "sensor_msgs/msg/Imu", "lidar": "foxglove.PointCloud"}
    left, right = ("/mocap/left", "/mocap/right") if role == "reference" else ("/left", "/right")
    for topic in (left, right):
        if role == "lidar":
            log.add(topic, T0, log.ros.cloud(T0, len(topic) * SPHERE))
        elif role == "reference":
            add_pose(log, topic)
        else:
            log.container.add(Channel(topic, kinds[role], "cdr", "", b""), T0, b"")
    roles = roles_of(log)
    assert roles.choices(role) == (
        f"2 topics could be the {role}; choose with  --set topics.{role}={left}  or  --set topics.{role}={right}"
    )
    assert roles_of(log, **{role: left}).choices(role) == ""


def test_possible_targets_are_listed_but_not_required(log: Any) -> None:
    add_pose(log, "/goal_pose")
    roles = roles_of(log)
    assert (roles.topic("target"), roles.topic("reference"), roles.targets) == (None, None, ("/goal_pose",))
    assert roles.choices("target") == "one topic could be the target; choose with  --set topics.target=/goal_pose"
    assert roles.of_topic("/goal_pose") == (None, "could be the target: --set topics.target=/goal_pose")
    roles = roles_of(log, target="/goal_pose")
    assert (roles.choices("target"), roles.topic("target")) == ("", "/goal_pose")


def test_configured_topics_are_checked(log: Any) -> None:
    log.add("/points", T0, log.ros.cloud(T0, SPHERE))
    log.add("/odom", T0, log.ros.odometry(T0, 0.0))
    with pytest.raises(UnknownTopic, match=r"/pints is not in the recording; topics of the recording: /points"):
        roles_of(log, lidar="/pints")
    with pytest.raises(UnknownTopic, match="/odom is nav_msgs/msg/Odometry, not a point cloud"):
        roles_of(log, lidar="/odom")
    with pytest.raises(UnknownTopic):
        roles_of(log, uwb=["/odom"])


def test_driver_packets_are_named(log: Any) -> None:
    log.container.add(Channel("/velodyne_packets", "velodyne_msgs/msg/VelodyneScan", "cdr", "", b""), T0, b"")
    roles = roles_of(log)
    assert roles.topic("lidar") is None
    assert "/velodyne_packets holds driver packets" in roles.why_none("lidar")
    assert "/velodyne_packets" not in roles.why_none("uwb")


def test_raw_byte_frames_and_mixed_topics_are_refused_with_a_reason(log: Any) -> None:
    log.container.add(Channel("/node0", "nlink_parser/msg/LinktrackNodeframe0", "cdr", "", b""), T0, b"")
    log.add("/odom", T0, log.ros.odometry(T0, 0.0))
    log.add("/odom", T0, log.ros.range(T0, 1.0))
    roles = roles_of(log)
    assert "raw bytes" in roles.why_none("uwb")
    assert roles.topic("odometry") is None
    assert "several types" in roles.unused["/odom"]


def test_empty_topics_play_no_role(log: Any) -> None:
    silent = log.ros.channel("/silent", "nav_msgs/msg/Odometry")
    silent = Channel(*(getattr(silent, name) for name in Channel.__slots__[:-1]), count=0)
    log.container.known["/silent", "nav_msgs/msg/Odometry"] = silent
    log.add("/odom", T0, log.ros.odometry(T0, 0.0))
    assert roles_of(log).topic("odometry") == "/odom"


@pytest.mark.skipif("QUADLOG_DATASETS" not in os.environ, reason="QUADLOG_DATASETS is not set")
@pytest.mark.parametrize(
    ("file", "role", "topic"),
    [
        ("lidar_16beam/vlp16.mcap", "lidar", "/velodyne_points"),
        ("lidar_16beam/helios16p.mcap", "lidar", "/rslidar_points"),
        ("uwb_lias/lias_fast.mcap", "uwb", "/nlink_linktrack_tagframe0"),
        ("uwb_lias/lias_fast.mcap", "reference", "/mocap/trolley/pose"),
        ("odometry/jackal_odom_imu.bag", "imu", "/imu/data"),
        ("edge_cases/lidar_fields/several_pointcloud2_types.bag", "lidar", "/cloud"),
    ],
)
def test_real_recordings(file: str, role: str, topic: str) -> None:
    with open_recording(Path(os.environ["QUADLOG_DATASETS"]) / file) as recording:
        assert detect_roles(recording, Topics()).topic(role) == topic


def test_many_topics_are_looked_through_once_and_few_are_listed(log: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(300):
        log.add(f"/odom_{number:03}", T0, log.ros.odometry(T0, 0.0))
    looks, channels = [], type(log.container).channels
    monkeypatch.setattr(type(log.container), "channels", property(lambda self: looks.append(1) or channels.fget(self)))
    compiled, largest = [], ros_messages.largest_payload_bytes
    monkeypatch.setattr(ros_messages, "largest_payload_bytes", lambda *each: compiled.append(1) or largest(*each))
    recording = Recording(log.container)
    roles = detect_roles(recording, Topics())
    for _ in recording.everything():
        pass
    assert roles.of_topic("/odom_299") == (
        None,
        "one of 300 that could be the odometry: --set topics.odometry=/odom_299",
    )
    assert (len(looks) < 20, len(compiled) < 3) == (True, True)
    with pytest.raises(
        AmbiguousTopic, match=r"300 topics .*topics\.odometry=/odom_019  or  one of 280 more$"
    ) as raised:
        roles.topic("odometry")
    assert len(raised.value.choices) == 300
