from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadlog.config import Topics
from quadlog.errors import AmbiguousTopic, UnknownTopic
from quadlog.recordings.container import Channel
from quadlog.recordings.recording import Recording, open_recording
from quadlog.recordings.roles import Roles, detect_roles

T0 = 1_700_000_000 * 10**9
SPHERE = np.random.default_rng(0).normal(size=(500, 3))
FLAT = SPHERE * [1, 1, 0]


def roles_of(log: Any, **topics: Any) -> Roles:
    return detect_roles(Recording(log.container), Topics(**topics))


def test_one_of_each(log: Any) -> None:
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


def test_ambiguity_lists_flags_to_paste_only_when_the_role_is_needed(log: Any) -> None:
    log.add("/left", T0, log.ros.cloud(T0, SPHERE))
    log.add("/right", T0, log.ros.cloud(T0, SPHERE))
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


def test_goals_are_targets_and_no_reference(log: Any) -> None:
    kind = log.ros.type("geometry_msgs/msg/PoseStamped")
    pose = log.ros.pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    log.add("/goal_pose", T0, kind(log.ros.header(T0), pose))
    roles = roles_of(log)
    assert roles.topic("reference") is None
    assert roles.targets == ("/goal_pose",)
    assert roles_of(log, target="/goal_pose").topic("target") == "/goal_pose"


def test_configured_topics_are_checked(log: Any) -> None:
    log.add("/points", T0, log.ros.cloud(T0, SPHERE))
    log.add("/odom", T0, log.ros.odometry(T0, 0.0))
    with pytest.raises(UnknownTopic, match=r"/pints is not in the recording; the recording has: /points"):
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
