"""Which topic plays which role: from logs that hold these topics, with these settings."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from quadlog.config.schema import Topics
from quadlog.errors import AmbiguousTopic, UnknownTopic
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.recording import Recording, open_recording
from quadlog.recordings.topics.roles import detect_roles

T0 = 1_700_000_000 * 10**9
SPHERE = np.random.default_rng(0).normal(size=(500, 3))
CLOUDS = {"cloud": SPHERE, "wide": 2 * SPHERE, "flat": SPHERE * [1, 1, 0], "few": SPHERE[:20]}
CLOUDS["empty"] = np.zeros((500, 3))
RAW = {
    "gtec": "gtec_msgs/msg/Ranging",
    "packets": "velodyne_msgs/msg/VelodyneScan",
    "bytes": "nlink_parser/msg/LinktrackNodeframe0",
    "imu": "sensor_msgs/msg/Imu",
    "fix": "sensor_msgs/msg/NavSatFix",
    "point": "geometry_msgs/msg/PointStamped",
}


def add(log, topic, kind):
    """A message of a kind; late: nine empty scans before full ones."""
    ros = log.ros
    if kind in RAW:
        log.container.add(Channel(topic, RAW[kind], "cdr", "", b""), T0, b"")
    elif kind in CLOUDS:
        log.add(topic, T0, ros.cloud(T0, CLOUDS[kind]))
    elif kind == "late":
        for k in range(12):
            log.add(topic, T0 + k, ros.cloud(T0 + k, SPHERE if k > 8 else np.full((500, 3), np.nan)))
    else:
        pose = ros.type("geometry_msgs/msg/PoseStamped")
        level = (0.0, 0.0, 0.0, 1.0)
        made = {
            "odometry": lambda: ros.odometry(T0, 0.0),
            "range": lambda: ros.range(T0, 1.0),
            "tf": ros.tf,
            "pose": lambda: pose(ros.header(T0), ros.pose((0.0, 0.0, 0.0), level)),
        }
        log.add(topic, T0, made[kind]())


def roles_of(log, topics, **settings):
    """topics: "/name kind, ..."."""
    for each in filter(None, topics.split(", ")):
        add(log, *each.split())
    return detect_roles(Recording(log.container), Topics(**settings))


TRUTHS = ("/pose_gt", "/robot/gtPose", "/vrpn_client_node/go2/pose", "/leica/pose", "/Vicon/base", "/mocap4r2/pose")
TRUTHS += ("/base_pose_ground_truth", "/motion_capture/rig")
NO_TRUTHS = ("/gtsam/pose", "/locomotive/pose", "/vicon/error", "/amcl_pose", "/slam/pose")
TWO = "/amcl_pose pose, /mocap/robot pose"


@pytest.mark.parametrize(
    ("topics", "settings", "role", "found"),
    [
        ("/points cloud, /odom odometry", {}, "lidar", "/points"),
        ("/points cloud, /odom odometry", {}, "odometry", "/odom"),
        ("/points cloud, /odom odometry", {}, "reference", None),
        ("/flat flat, /points cloud, /radar cloud, /few few", {}, "lidar", "/points"),
        ("/points late", {}, "lidar", "/points"),
        ("/points late, /other cloud", {}, "lidar", "/other"),
        ("/points empty", {}, "lidar", None),
        ("/left cloud, /right wide", {"lidar": "/right"}, "lidar", "/right"),
        ("/odom odometry, /ground_truth/odom odometry", {}, "odometry", "/odom"),
        ("/odom odometry, /ground_truth/odom odometry", {}, "reference", "/ground_truth/odom"),
        ("/mpc/desired odometry, /odom odometry", {}, "odometry", "/odom"),
        ("/goal_pose pose", {}, "target", None),
        ("/goal_pose pose", {"target": "/goal_pose"}, "target", "/goal_pose"),
        ("/packets packets", {}, "lidar", None),
        ("/odom odometry, /odom range", {}, "odometry", None),
        ("/fix fix", {}, "gnss", "/fix"),
        ("/fix fix, /slam/pose pose", {}, "pose", "/slam/pose"),
        # What somebody clicked is no estimate of the robot's pose.
        ("/clicked_point point", {}, "pose", None),
        ("/clicked_point point", {"position": "/clicked_point"}, "position", "/clicked_point"),
        ("/leica/point point", {}, "reference", "/leica/point"),
        *((f"{name} pose", {}, "reference", name) for name in TRUTHS),
        *((f"{name} pose", {}, "reference", None) for name in NO_TRUTHS),
        ("/slam/pose pose", {"reference": "/slam/pose"}, "reference", "/slam/pose"),
        ("/pose_gt pose", {"reference": "none"}, "reference", None),
        # What is worse than the position is no truth for it, and a file or a source by name is no topic.
        (TWO, {"position": "/amcl_pose"}, "reference", "/mocap/robot"),
        (TWO, {"position": "/mocap/robot"}, "reference", None),
        *((TWO, {"position": each}, "reference", "/mocap/robot") for each in ("truth.tum", "tf", "auto")),
    ],
)
def test_a_role_is_played_by(log, topics, settings, role, found):
    assert roles_of(log, topics, **settings).topic(role) == found


def test_roles_of_several_topics(log):
    poses = ", ".join(f"{name} pose" for name in ("/amcl_pose", "/orb_slam3/pose", "/mocap/robot", "/goal_pose"))
    roles = roles_of(log, f"/uwb/n_0/n_2 range, /uwb/n_0/n_3 range, /tf tf, {poses}, /tracking_error pose")
    assert roles.topics("uwb") == ("/uwb/n_0/n_2", "/uwb/n_0/n_3")
    assert roles.topics("tf") == ("/tf",)
    assert roles.topics("pose") == ("/amcl_pose", "/orb_slam3/pose")
    assert roles.targets == ("/goal_pose",)


@pytest.mark.parametrize(
    ("topics", "settings", "role", "choices"),
    [
        ("/left cloud, /right wide", {}, "lidar", ["/left", "/right"]),
        ("/points late, /few few", {}, "lidar", ["/few", "/points"]),
        ("/left imu, /right imu", {}, "imu", ["/left", "/right"]),
        ("/left odometry, /right odometry", {}, "odometry", ["/left", "/right"]),
        ("/mocap/left pose, /mocap/right pose", {}, "reference", ["/mocap/left", "/mocap/right"]),
        # Another body is not taken for the truth of the position.
        ("/mocap/person pose, /mocap/robot pose", {"position": "/mocap/robot"}, "reference", ["/mocap/person"]),
        (
            "/uwb/n_0/n_1 range, /uwb/n_0/n_2 range, /gtec gtec",
            {},
            "uwb",
            ["/gtec", '["/uwb/n_0/n_1", "/uwb/n_0/n_2"]'],
        ),
    ],
)
def test_what_could_play_a_role_is_listed_with_flags_to_paste(log, topics, settings, role, choices):
    """Only when the role is needed."""
    roles = roles_of(log, topics, **settings)
    with pytest.raises(AmbiguousTopic) as raised:
        roles.topics(role)
    assert all(f"topics.{role}={each}" in str(raised.value) for each in choices)
    if role != "uwb":
        assert roles_of(log, "", **settings | {role: choices[0]}).choices(role) == ""


@pytest.mark.parametrize(
    ("topics", "settings", "words"),
    [
        ("/points cloud", {"lidar": "/pints"}, "topics of the recording: /points"),
        ("/odom odometry", {"lidar": "/odom"}, "not a point cloud"),
        ("/odom odometry", {"uwb": ["/odom"]}, "/odom"),
        ("/points cloud", {"position": "/points"}, "not a pose"),
        *(
            ("/mocap/robot pose", {"reference": "/mocap/robot", of: "/mocap/robot"}, of)
            for of in ("position", "odometry")
        ),
    ],
)
def test_a_topic_that_cannot_play_its_role_is_refused(log, topics, settings, words):
    with pytest.raises(UnknownTopic, match=words):
        roles_of(log, topics, **settings)


@pytest.mark.parametrize(
    ("topic", "kind", "words"),
    [
        ("/flat", "flat", "2-D"),
        ("/radar", "cloud", "radar"),
        ("/few", "few", "20 points"),
        ("/packets", "packets", "driver packets"),
        ("/node0", "bytes", "raw bytes"),
        ("/clicked_point", "point", "--set topics.position=/clicked_point"),
    ],
)
def test_why_a_topic_is_not_used(log, topic, kind, words):
    assert words in roles_of(log, f"{topic} {kind}, /points cloud").unused[topic]


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
def test_real_recordings(file, role, topic):
    with open_recording(Path(os.environ["QUADLOG_DATASETS"]) / file) as recording:
        assert detect_roles(recording, Topics()).topic(role) == topic


def test_many_topics_are_looked_at_once_and_few_are_listed(log, monkeypatch):
    looks, messages, recording = Counter(), log.container.messages, Recording(log.container)
    monkeypatch.setattr(log.container, "messages", lambda topics, *window: looks.update(topics) or messages(topics))
    for number in range(300):
        add(log, f"/odom_{number:03}", "odometry")
    roles = detect_roles(recording, Topics())
    assert all(recording.peek(topic, 1)[0] for topic in [*looks])
    assert set(looks.values()) == {1}
    with pytest.raises(AmbiguousTopic, match="280 more") as raised:
        roles.topic("odometry")
    assert str(raised.value).startswith("300 ")
