"""Which topic plays which role, with which settings, and what makes topics usable that quadlog does not read."""

from __future__ import annotations

import os
import tomllib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from quadlog.config.schema import Config, Topics
from quadlog.errors import AmbiguousTopic, UnknownTopic
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.recording import Recording, open_recording
from quadlog.recordings.topics.roles import detect_roles
from quadlog.recordings.topics.unread import PLUGIN, hint, nearest_role, unread

T0 = 1_700_000_000 * 10**9
SPHERE = np.random.default_rng(0).normal(size=(500, 3))
CLOUDS = {"cloud": SPHERE, "wide": 2 * SPHERE, "flat": SPHERE * [1, 1, 0], "few": SPHERE[:20]}
CLOUDS["empty"] = np.zeros((500, 3))
RAW = {
    "Odometry": "nav_msgs/msg/Odometry",
    "Range": "sensor_msgs/msg/Range",
    "Tf": "tf2_msgs/msg/TFMessage",
    "Pose": "geometry_msgs/msg/PoseStamped",
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
        log.add(topic, T0, ros.make(RAW[kind.title()]))


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


VICON = "float32 x_trans\nfloat32 y_trans\nfloat32 z_trans\nfloat32 x_rot\nfloat32 y_rot\nfloat32 z_rot\nfloat32 w\n"
NODES = "uint8 id\nNode[] nodes\n=====\nMSG: lab/Node\nuint8 id\nfloat32 dis\nfloat32[3] pos\n"
PLACE = "geometry_msgs/Point place\nfloat64 yaw_deg\n=====\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
IDL = (
    "module lab { module msg { struct A { double posX, posY, posZ; double qx; double qy; double qz; double qw; }; }; };"
)
PX4 = "uint64 timestamp\nfloat32[3] position\nfloat32[4] q\nfloat32[3] velocity\nfloat32[3] angular_velocity\n"
PX4 += "float32[3] position_variance\nfloat32[3] orientation_variance\nuint8 reset_counter\n"
SIX, FOUR = (
    ["poll_tx_ts", "poll_rx_ts", "resp_tx_ts", "resp_rx_ts", "final_tx_ts", "final_rx_ts"],
    ["Tround1", "Treply1", "Tround2", "Treply2"],
)
ENDS = "uint16 initiator\nuint16 responder\n"
VICON_FIELDS = ["x_trans", "y_trans", "z_trans", "x_rot", "y_rot", "z_rot", "w"]


@pytest.mark.parametrize(
    ("text", "keys"),
    [
        (f"string name\n{VICON}", {"fields": VICON_FIELDS, "unit": "m"}),
        ("float64 x_mm\nfloat64 y_mm\nfloat64 z_mm\nfloat64 vx\n", {"fields": ["x_mm", "y_mm", "z_mm"], "unit": "mm"}),
        (PLACE, {"fields": ["place.x", "place.y", "place.z"], "unit": "m"}),
        (IDL, {"fields": ["posX", "posY", "posZ", "qx", "qy", "qz", "qw"], "unit": "m"}),
        ("float32 x\nfloat32 y\nfloat32 theta\n", {}),
        (NODES, {"tag": "id", "anchor": "nodes[].id", "field": "nodes[].dis", "unit": "m"}),
        ("uint16 anchor\nuint32 range_mm\n", {"tag": 0, "anchor": "anchor", "field": "range_mm", "unit": "mm"}),
        ("uint16 initiator\nuint16 responder\nfloat64 distance\n", {"tag": "initiator", "anchor": "responder"}),
        ("uint16 anchor\nfloat32 range_min\nfloat32 maxRange\nfloat32 range\n", {"anchor": "anchor", "field": "range"}),
        ("uint16 anchor\nfloat32 min_range\nfloat32 range_max\nfloat32 distance_std\n", {}),
        ("float64 distance\nfloat64 quality\n", {}),
        ("float32 linear_x\nfloat32 linear_y\n", {}),
        ("Header header\n", {}),
        ("string child_frame_id\nstring tag\nstring anchor\nfloat32 range\n", {"tag": "tag", "anchor": "anchor"}),
        (f"{PX4}", {"fields": [f"position[{i}]" for i in range(3)] + [f"q[{i}]" for i in (1, 2, 3, 0)]}),
        (
            "float64[4] quat\nfloat64[3] pos_mm\n",
            {"fields": [f"pos_mm[{i}]" for i in range(3)] + [f"quat[{i}]" for i in (1, 2, 3, 0)], "unit": "mm"},
        ),
        ("float32[3] gyro_rad\nfloat32[3] accelerometer_m_s2\n", {}),
        (
            ENDS + "".join(f"uint64 {name}\n" for name in reversed(SIX)),
            {"tag": "initiator", "times": SIX, "tick_s": 1.565e-11},
        ),
        (ENDS + "".join(f"uint32 {name}\n" for name in FOUR), {"anchor": "responder", "times": FOUR}),
        (ENDS + "".join(f"uint64 t{i}\n" for i in range(1, 7)), {"times": [f"t{i}" for i in range(1, 7)]}),
        (ENDS + "uint64 time_tx\nuint64 time_rx\n", {}),
        ("float32[] values # not a definition {\nB b", {}),
    ],
)
def test_keys_for_messages_with_a_pose_or_ranges_by_the_names_of_their_fields(text, keys):
    encoding = "ros2idl" if text is IDL else "ros2msg"
    said = hint(Channel("/lab/a", "lab/msg/A", "cdr", encoding, text.encode()))
    if not keys:
        assert said == PLUGIN
        return
    ((section, inner),) = tomllib.loads(said).items()
    ((name, (row,)),) = inner.items()
    assert (section, name) == (("topics", "poses") if "fields" in keys else ("uwb", "range_topics"))
    assert row | keys == row
    Config.model_validate(tomllib.loads(said))
    assert (row["topic"], "# or" in said) == ("/lab/a", row.get("unit") == "m")


def test_px4_is_north_east_down():
    text = hint(Channel("/fmu/out/vehicle_odometry", "px4_msgs/msg/VehicleOdometry", "cdr", "ros2msg", PX4.encode()))
    fields = tomllib.loads(text)["topics"]["poses"][0]["fields"]
    assert fields == ["position[0]", "-position[1]", "-position[2]", "q[1]", "-q[2]", "-q[3]", "q[0]"]


@pytest.mark.parametrize(
    ("type_name", "role", "words"),
    [
        ("velodyne_msgs/msg/VelodyneScan", "lidar", "velodyne_pointcloud"),
        ("ouster_sensor_msgs/msg/PacketMsg", "lidar", "ouster_ros"),
        ("point_cloud_interfaces/msg/CompressedPointCloud2", "lidar", "republish"),
        ("gps_msgs/msg/GPSFix", None, "NavSatFix"),
        ("sensor_msgs/msg/CompressedImage", None, ""),
        ("diagnostic_msgs/msg/DiagnosticArray", None, ""),
        ("nav_msgs/msg/Odometry", "odometry", ""),
        ("any/msg/{brace", None, "howto/plugins"),
        ("sensor_msgs/msg/Range", "uwb", "uwb.range_topics"),
    ],
)
def test_drivers_for_raw_data_and_nothing_for_what_no_replay_needs(type_name, role, words):
    channel = Channel("/a", type_name, "cdr", "", b"")
    said, row = hint(channel), unread(channel)
    assert (bool(said), words in said, nearest_role(channel)) == (bool(words), True, role)
    assert row is None or not row.role or said in row.words


@pytest.mark.parametrize("type_name", ["px4_msgs/msg/SensorGps", "gps_msgs/msg/GPSStatus", "gps_msgs/msg/GPSFix"])
def test_for_satellites_the_type_that_is_read_is_named(type_name):
    assert "NavSatFix" in unread(Channel("/a", type_name, "cdr", "", b"")).words
