from __future__ import annotations

import numpy as np
import pytest
from mcap_ros1._vendor.genpy.dynamic import generate_dynamic as ros1_types
from mcap_ros2._dynamic import generate_dynamic as ros2_types

from quadlog.messages import JointStates, UwbRanges
from quadlog.simulation.synthetic.recording import START_NS
from quadlog.simulation.synthetic.ros_encoding import POINT, TYPE_NAMES, RosEncoder


def decode(encoder, message, sequence=0):
    """By a decoder that is not rosbags', from the definition that goes into the recording."""
    type_name = TYPE_NAMES[type(message)]
    text, payload = encoder.definition(type_name).text, encoder.encode(message, sequence)
    if encoder.version == 2:
        return ros2_types(type_name, text)[type_name](payload)
    name = type_name.replace("/msg/", "/")
    return ros1_types(name, text)[name]().deserialize(payload)


@pytest.fixture(params=[1, 2], ids=["ros1", "ros2"])
def encoder(request):
    return RosEncoder(request.param)


def stamp_ns(header):
    parts = header.stamp
    return getattr(parts, "sec", 0) * 10**9 + parts.nanosec if hasattr(parts, "nanosec") else parts.to_nsec()


def test_a_scan_is_a_velodyne_cloud(encoder, short):
    scan = next(short.scans())
    decoded = decode(encoder, scan, 4)
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


def test_ranges_stand_at_their_anchors_place_and_absent_ones_are_zero(encoder):
    ranges = UwbRanges(1_767_225_600_123_456_789, 1, np.array([0, 3]), np.array([2.5, 7.25]))
    decoded = decode(encoder, ranges)
    assert stamp_ns(decoded.header) == ranges.stamp_ns
    assert (decoded.role, decoded.id) == (2, 1)
    assert list(decoded.dis_arr) == [2.5, 0, 0, 7.25, 0, 0, 0, 0]


def test_joints_have_the_names_of_unitrees_robots_and_feet_a_force_for_an_effort(encoder):
    values = np.arange(40.0)
    decoded = decode(encoder, JointStates(START_NS, values[:12], values[12:24], values[24:36], values[36:]))
    assert decoded.name[:4] == ["FL_hip_joint", "FL_thigh_joint", "FL_calf_joint", "FR_hip_joint"]
    assert decoded.name[12:] == ["FL_foot", "FR_foot", "RL_foot", "RR_foot"]
    assert stamp_ns(decoded.header) == START_NS
    assert list(decoded.position) == [*values[:12], 0, 0, 0, 0]
    assert list(decoded.velocity) == [*values[12:24], 0, 0, 0, 0]
    assert list(decoded.effort) == list(values[24:])
