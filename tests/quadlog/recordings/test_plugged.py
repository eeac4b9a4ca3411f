"""Decoders of plug-ins, in recordings of the message types that they are for."""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np
import pytest

from quadlog.config.plugins import DECODERS
from quadlog.config.schema import Topics
from quadlog.errors import DecodeError, PluginNameTaken, PluginUnusable
from quadlog.messages import Imu, Odometry, PointCloud, Pose, Transforms, UwbRanges
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.plugged import MessageDecoder, interpreter
from quadlog.recordings.recording import Recording
from quadlog.recordings.roles import detect_roles
from quadlog.recordings.survey import survey

T0 = 1_700_000_000 * 10**9
QUAT = np.array([0.0, 0.0, 0.0, 1.0])
XYZ = np.zeros(3)

BEACON = """
from quadlog.messages import {gives}
from quadlog.recordings.plugged import MessageDecoder
def decode(message, topic):
    {body}
decoder = MessageDecoder(gives={gives}, decode=decode)
"""
RANGES = "yield UwbRanges(message['t'], 3, [5, 7], message['m'])"


def add_json(log: Any, topic: str, type_name: str, **fields: Any) -> None:
    channel = Channel(topic, type_name, "json", "jsonschema", b"")
    log.container.add(channel, T0 + len(log.container.raw), json.dumps(fields).encode())


def plug_in(install: Any, type_name: str, gives: str, body: str) -> None:
    install(
        "quadlog-beacons",
        "1.0",
        {DECODERS: {type_name: "beacons:decoder"}},
        {"beacons": BEACON.format(gives=gives, body=body)},
    )


def test_a_json_type_of_ones_own_becomes_ranges_with_a_role(install, log):
    plug_in(install, "beacon.Report", "UwbRanges", RANGES)
    add_json(log, "/beacons", "beacon.Report", t=T0, m=[1.5, 2.5])
    add_json(log, "/beacons", "beacon.Report", t=T0 + 1, m=[1.0, 2.0])
    recording = Recording(log.container)
    first, second = (each.message for each in recording.messages(["/beacons"]))
    assert isinstance(first, UwbRanges)
    assert (first.stamp_ns, second.stamp_ns, first.tag) == (T0, T0 + 1, 3)
    assert (first.anchor.dtype, first.range_m.dtype) == (np.int64, np.float64)
    assert (first.anchor.tolist(), first.range_m.tolist()) == ([5, 7], [1.5, 2.5])
    roles = detect_roles(recording, Topics())
    assert roles.of_topic("/beacons") == ("uwb", "the only beacon.Report")
    links = survey(recording).links["/beacons"]
    assert [(link.tag, link.anchor, link.messages) for link in links] == [(3, 5, 2), (3, 7, 2)]
    assert recording.losses == []


def test_a_ros_type_comes_with_its_fields(install, log):
    """A standard type that quadlog has no use for, with the definition the recording embeds."""
    plug_in(
        install,
        "geometry_msgs/msg/PointStamped",
        "Pose",
        "return [Pose(message.header.stamp.sec * 10**9, "
        "message.header.frame_id, 'rover', [message.point.x, message.point.y, 0], [0, 0, 0, 2])]",
    )
    point = log.ros.type("geometry_msgs/msg/PointStamped")(
        log.ros.header(T0, "site"), log.ros.type("geometry_msgs/msg/Point")(3.0, -4.0, 9.0)
    )
    log.add("/mocap/rover", T0, point)
    recording = Recording(log.container)
    (timed,) = recording.messages(["/mocap/rover"])
    pose = timed.message
    assert isinstance(pose, Pose)
    assert (timed.t_ns, pose.frame_id, pose.child_frame_id) == (T0, "site", "rover")
    assert (pose.position_m.tolist(), pose.quat_xyzw.tolist()) == ([3, -4, 0], [0, 0, 0, 1])
    assert detect_roles(recording, Topics()).topic("reference") == "/mocap/rover"


def test_driver_packets_that_a_plugin_decodes_are_refused_no_longer(install, log):
    add_json(log, "/packets", "velodyne_msgs/msg/VelodyneScan", n=200)
    roles = detect_roles(Recording(log.container), Topics())
    assert "driver packets" in roles.unused["/packets"]
    plug_in(
        install,
        "velodyne_msgs/msg/VelodyneScan",
        "PointCloud",
        "import numpy as np; yield PointCloud(None, 'velodyne', "
        "np.random.default_rng(0).normal(size=(message['n'], 3)))",
    )
    recording = Recording(log.container)
    assert detect_roles(recording, Topics()).topic("lidar") == "/packets"
    (timed,) = recording.messages(["/packets"])
    assert isinstance(timed.message, PointCloud)
    assert timed.message.xyz_m.dtype == np.float32


def test_messages_that_a_plugin_cannot_decode_are_a_loss(install, log):
    plug_in(install, "beacon.Report", "UwbRanges", RANGES)
    add_json(log, "/beacons", "beacon.Report", t=T0)
    add_json(log, "/beacons", "beacon.Report", t=T0, m=[1.0, 2.0])
    add_json(log, "/beacons", "beacon.Report", t=T0, m=[1.0, 2.0, 3.0])
    recording = Recording(log.container)
    assert len(list(recording.messages(["/beacons"]))) == 1
    (loss,) = recording.losses
    assert (loss.cause, loss.topic, loss.count) == ("decode", "/beacons", 2)
    assert "its plug-in failed: KeyError: 'm'" in loss.detail


@pytest.mark.parametrize(
    "taken",
    [
        "nav_msgs/msg/Odometry",
        "any/msg/LinktrackTagframe0",
        "foxglove.PointCloud",
        "livox_ros_driver2/msg/CustomMsg",
    ],
)
def test_a_type_of_quadlogs_own_is_refused(install, log, taken):
    plug_in(install, taken, "Pose", "return []")
    add_json(log, "/own", taken)
    with pytest.raises(PluginNameTaken, match=rf"decoder {taken}: .*quadlog, quadlog-beacons 1\.0"):
        list(Recording(log.container).everything())


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("decoder = print", "is no MessageDecoder but builtin_function_or_method"),
        ("raise ImportError('no driver here')", "cannot be loaded: ImportError: no driver here"),
        (
            "from quadlog.recordings.plugged import MessageDecoder\ndecoder = MessageDecoder(str, print)",
            "gives str, which is not one of PointCloud, UwbRanges, Pose, Odometry, Imu, Transforms",
        ),
    ],
)
def test_an_object_that_is_no_decoder_is_refused(install, log, source, said):
    install("quadlog-odd", "1.0", {DECODERS: {"odd.Type": "odd:decoder"}}, {"odd": source})
    add_json(log, "/odd", "odd.Type")
    with pytest.raises(PluginUnusable) as raised:
        detect_roles(Recording(log.container), Topics())
    assert said in str(raised.value)


def test_a_plugin_for_another_type_is_not_imported(install, log):
    install("quadlog-odd", "1.0", {DECODERS: {"odd.Type": "odd:decoder"}}, {"odd": "raise ImportError"})
    log.add("/odom", T0, log.ros.odometry(T0, 0.0))
    assert detect_roles(Recording(log.container), Topics()).topic("odometry") == "/odom"


def decoded(message: Any, gives: type) -> Any:
    (found,) = interpreter(MessageDecoder(gives, lambda *_: [message]))(None, "/topic")
    return found


def test_every_kind_passes_with_its_types():
    cloud = decoded(PointCloud(None, "lidar", [[1, 2, 3]], ring=[4], offset_ns=[5]), PointCloud)  # type: ignore[arg-type]
    assert (cloud.xyz_m.dtype, cloud.ring.dtype, cloud.offset_ns.dtype) == (np.float32, np.uint16, np.int64)
    assert decoded(PointCloud(None, "lidar", np.zeros((0, 3), np.float32)), PointCloud).ring is None
    ranges = decoded(UwbRanges(np.int64(7), np.uint8(2), [], []), UwbRanges)  # type: ignore[arg-type]
    assert (type(ranges.stamp_ns), type(ranges.tag), ranges.first_path_gap_db) == (int, int, None)
    odometry = decoded(Odometry(1, "odom", "base", XYZ, 2 * QUAT, XYZ, XYZ), Odometry)
    assert odometry.quat_xyzw.tolist() == QUAT.tolist()
    assert decoded(Imu(1, "imu", None, XYZ, XYZ), Imu).quat_xyzw is None
    transforms = decoded(Transforms(None, (Pose(1, "map", "odom", [1, 2, 3], QUAT),), True), Transforms)  # type: ignore[arg-type]
    assert transforms.transforms[0].position_m.dtype == np.float64


@pytest.mark.parametrize(
    ("message", "gives", "said"),
    [
        (Pose(1, "map", "", XYZ, QUAT), Imu, "gave Pose instead of Imu"),
        (None, Pose, "gave NoneType instead of Pose"),
        (Pose(1.5, "map", "", XYZ, QUAT), Pose, "TypeError: 'float' object"),
        (Pose(1, None, "", XYZ, QUAT), Pose, "gave a frame_id that is no text"),
        (Pose(1, "map", 7, XYZ, QUAT), Pose, "gave a child_frame_id that is no text"),
        (Pose(1, "map", "", XYZ[:2], QUAT), Pose, r"position_m of shape \(2,\), not \(3,\)"),
        (Pose(1, "map", "", XYZ, None), Pose, "quat_xyzw"),
        (Pose(1, "map", "", XYZ, QUAT * np.nan), Pose, "quaternion is not finite"),
        (Pose(1, "map", "", [0, 1e300, 0], QUAT), Pose, "position is not finite, or beyond"),
        (Odometry(1, "map", "", XYZ * np.nan, QUAT, XYZ, XYZ), Odometry, "position is not finite"),
        (Transforms(1, (Pose(1, "map", "", XYZ + np.inf, QUAT),), False), Transforms, "position is not finite"),
        (Pose(1, "map", "", ["a", "b", "c"], QUAT), Pose, "ValueError"),
        (UwbRanges(1, 0, [1, 2], [1.0]), UwbRanges, r"range_m of shape \(1,\), not \(2,\)"),
        (UwbRanges(1, 0, 1, 1.0), UwbRanges, r"anchor of shape \(\), not \(0,\)"),
        (UwbRanges(1, "x", [1], [1.0]), UwbRanges, "TypeError"),
        (PointCloud(1, "l", np.zeros((4, 2))), PointCloud, r"xyz_m of shape \(4, 2\), not \(4, 3\)"),
        (
            PointCloud(1, "l", np.zeros((4, 3)), offset_ns=np.zeros(3)),
            PointCloud,
            r"offset_ns of shape \(3,\), not \(4,\)",
        ),
        (Transforms(None, (None,), False), Transforms, "gave NoneType instead of Pose"),
    ],
)
def test_an_answer_of_another_kind_or_shape_is_not_decoded(message, gives, said):
    with pytest.raises(DecodeError, match=said) as raised:
        decoded(message, gives)
    assert "DecodeError" not in str(raised.value)


def leave(*_: Any) -> Any:
    raise SystemExit(0)


def stop(*_: Any) -> Any:
    raise BaseException("enough")


def stamped(t_ns: int) -> Any:
    return lambda *_: [Pose(t_ns, "map", "base", XYZ, QUAT)]


@pytest.mark.parametrize(
    ("decode", "said"),
    [
        *((leave, "SystemExit: 0"), (stop, "BaseException: enough"), (lambda *_: os._exit(0), r"os._exit\(0\)")),
        *((lambda *_: None, "TypeError"), (stamped(2**63), f"stamp_ns of {2**63}"), (stamped(-(10**30)), "64 bits")),
    ],
)
def test_a_decoder_cannot_end_quadlog_and_gives_something_iterable(decode, said):
    with pytest.raises(DecodeError, match=said):
        interpreter(MessageDecoder(Pose, decode))(None, "/topic")
