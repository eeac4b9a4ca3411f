from __future__ import annotations

import numpy as np
from mcap_ros2._dynamic import generate_dynamic as ros2_types

from quadlog.messages import JointStates, UwbRanges
from quadlog.simulation.synthetic.recording import START_NS
from quadlog.simulation.synthetic.ros_encoding import ENCODED, POINT, RosEncoder

ENCODER = RosEncoder()


def decode(message):
    """By a decoder that is not rosbags', from the definition that goes into the recording."""
    type_name = ENCODED[type(message)][0]
    return ros2_types(type_name, ENCODER.definition(type_name))[type_name](ENCODER.encode(message))


def stamp_ns(header):
    return header.stamp.sec * 10**9 + header.stamp.nanosec


def test_a_scan_is_a_velodyne_cloud(short):
    scan = next(short.scans())
    decoded = decode(scan)
    assert stamp_ns(decoded.header) == scan.cloud.stamp_ns
    assert decoded.header.frame_id == "lidar"
    fields = [(field.name, field.offset, field.datatype, field.count) for field in decoded.fields]
    assert fields == [
        ("x", 0, 7, 1),
        ("y", 4, 7, 1),
        ("z", 8, 7, 1),
        ("intensity", 12, 7, 1),
        ("ring", 16, 4, 1),
        ("time", 18, 7, 1),
    ]
    assert (decoded.point_step, decoded.height, decoded.width) == (22, 1, len(scan.intensity))
    assert decoded.row_step == 22 * decoded.width == len(decoded.data)
    points = np.frombuffer(bytes(decoded.data), dtype=POINT)
    np.testing.assert_array_equal(np.column_stack([points["x"], points["y"], points["z"]]), scan.cloud.xyz_m)
    np.testing.assert_array_equal(points["ring"], scan.cloud.ring)
    np.testing.assert_allclose(points["time"] * 1e9, scan.cloud.offset_ns, rtol=1e-6, atol=1e-3)


def test_ranges_stand_at_their_anchors_place_and_absent_ones_are_zero():
    ranges = UwbRanges(1_767_225_600_123_456_789, 1, np.array([0, 3]), np.array([2.5, 7.25]))
    decoded = decode(ranges)
    assert stamp_ns(decoded.header) == ranges.stamp_ns
    assert (decoded.role, decoded.id) == (2, 1)
    assert list(decoded.dis_arr) == [2.5, 0, 0, 7.25, 0, 0, 0, 0]


def test_joints_have_the_names_of_unitrees_robots_and_feet_a_force_for_an_effort():
    values = np.arange(40.0)
    decoded = decode(JointStates(START_NS, values[:12], values[12:24], values[24:36], values[36:]))
    assert decoded.name[:4] == ["FL_hip_joint", "FL_thigh_joint", "FL_calf_joint", "FR_hip_joint"]
    assert decoded.name[12:] == ["FL_foot", "FR_foot", "RL_foot", "RR_foot"]
    assert stamp_ns(decoded.header) == START_NS
    assert list(decoded.position) == [*values[:12], 0, 0, 0, 0]
    assert list(decoded.velocity) == [*values[12:24], 0, 0, 0, 0]
    assert list(decoded.effort) == list(values[24:])
