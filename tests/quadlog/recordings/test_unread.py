"""What makes types usable that quadlog does not read: keys by the fields of their definitions, or a driver."""

from __future__ import annotations

import tomllib

import pytest

from quadlog.config.schema import Config
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.topics.unread import PLUGIN, hint, nearest_role, unread

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
