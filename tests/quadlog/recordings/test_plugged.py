"""Decoders of plug-ins, in recordings of the message types that they are for."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest

from quadlog.config.schema import Config, Topics
from quadlog.errors import DecodeError, QuadlogError
from quadlog.messages import Imu, Odometry, PointCloud, Pose, Transforms, UwbRanges
from quadlog.plugins import DECODERS
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.plugged import MessageDecoder, interpreter
from quadlog.recordings.recording import Recording
from quadlog.recordings.survey import survey
from quadlog.recordings.topics.roles import detect_roles

T0 = 1_700_000_000 * 10**9
QUAT = np.array([0.0, 0.0, 0.0, 1.0])
XYZ = np.zeros(3)

PLUGIN = """
import numpy as np
from quadlog.messages import {gives}
from quadlog.recordings.plugged import MessageDecoder
def decode(message, topic):
    {body}
decoder = MessageDecoder(gives={gives}, decode=decode)
"""
RANGES = "UwbRanges", "yield UwbRanges(message['t'], 3, [5, 7], message['m'])"
CLOUD = "PointCloud", "yield PointCloud(None, 'velodyne', np.random.default_rng(0).normal(size=(message['n'], 3)))"
AT = "message.header.stamp.sec * 10**9, message.header.frame_id, 'rover'"
POSE = "Pose", f"p = message.point; return [Pose({AT}, [p.x, p.y, 0], [0, 0, 0, 2])]"


def add_json(log, topic, type_name, **fields):
    channel = Channel(topic, type_name, "json", "jsonschema", b"")
    log.container.add(channel, T0 + len(log.container.raw), json.dumps(fields).encode())


def plug_in(install, type_name, gives="Pose", body="return []", source=None):
    source = source or PLUGIN.format(gives=gives, body=body)
    install("quadlog-beacons", "1.0", {DECODERS: {type_name: "beacons:decoder"}}, {"beacons": source})


def test_a_json_type_of_ones_own_becomes_ranges_with_a_role_and_failures_are_a_loss(install, log):
    plug_in(install, "beacon.Report", *RANGES)
    for fields in ({"t": T0, "m": [1.5, 2.5]}, {"t": T0 + 1, "m": [1.0, 2.0]}, {"t": T0}, {"t": T0, "m": [1.0] * 3}):
        add_json(log, "/beacons", "beacon.Report", **fields)
    recording = Recording(log.container)
    for _ in range(2):  # reading again does not count the same losses again
        first, second = (each.message for each in recording.messages(["/beacons"]))
    assert (first.stamp_ns, second.stamp_ns, first.tag) == (T0, T0 + 1, 3)
    assert (first.anchor.dtype, first.range_m.dtype) == (np.int64, np.float64)
    assert (first.anchor.tolist(), first.range_m.tolist()) == ([5, 7], [1.5, 2.5])
    (loss,) = recording.losses
    assert (loss.cause, loss.topic, loss.count) == ("decode", "/beacons", 2)
    assert detect_roles(recording, Topics()).topics("uwb") == ("/beacons",)
    links = survey(recording).links["/beacons"]
    assert [(link.tag, link.anchor, link.messages) for link in links] == [(3, 5, 2), (3, 7, 2)]


@pytest.mark.parametrize("unit", ["m", "cm", "mm"])
def test_a_unit_that_is_configured_is_that_of_the_plugins_numbers(install, log, unit):
    """Also of a type whose messages quadlog itself takes for mm."""
    plug_in(install, "gtec_msgs/msg/Ranging", *RANGES)
    add_json(log, "/beacons", "gtec_msgs/msg/Ranging", t=T0, m=[1.5, 2.5])
    row = {"topic": "/beacons", "unit": unit}
    recording = Recording(log.container, Config.model_validate({"uwb": {"range_topics": [row]}}))
    (timed,) = recording.messages("/beacons")
    assert timed.message.range_m == pytest.approx(np.array([1.5, 2.5]) * {"m": 1, "cm": 0.01, "mm": 0.001}[unit])


def test_a_ros_type_comes_with_its_fields(install, log):
    """A standard type that quadlog has no use for, with the definition the recording embeds."""
    plug_in(install, "geometry_msgs/msg/PointStamped", *POSE)
    point = {"header": log.ros.header(T0, "site"), "point": log.ros.vector(3, -4, 9, name="Point")}
    log.add("/mocap/rover", T0, log.ros.make("geometry_msgs/msg/PointStamped", **point))
    recording = Recording(log.container)
    (timed,) = recording.messages(["/mocap/rover"])
    pose = timed.message
    assert (timed.t_ns, pose.frame_id, pose.child_frame_id) == (T0, "site", "rover")
    assert (pose.position_m.tolist(), pose.quat_xyzw.tolist()) == ([3, -4, 0], [0, 0, 0, 1])
    assert detect_roles(recording, Topics()).topic("reference") == "/mocap/rover"


def test_driver_packets_that_a_plugin_decodes_are_a_lidar(install, log):
    plug_in(install, "velodyne_msgs/msg/VelodyneScan", *CLOUD)
    add_json(log, "/packets", "velodyne_msgs/msg/VelodyneScan", n=200)
    recording = Recording(log.container)
    assert detect_roles(recording, Topics()).topic("lidar") == "/packets"
    (timed,) = recording.messages(["/packets"])
    assert timed.message.xyz_m.dtype == np.float32


@pytest.mark.parametrize("own", ["nav_msgs/msg/Odometry", "foxglove.PointCloud"])
def test_a_type_of_quadlogs_own_is_the_plugins_with_a_note(install, log, own):
    """Types become quadlog's own from one version to the next; who wrote a decoder means it."""
    plug_in(install, own, "Imu", "yield Imu(None, 'imu', None, [0, 0, 1], [0, 0, 9])")
    if own.startswith("foxglove"):
        add_json(log, "/own", own)
    else:
        log.add("/own", T0, log.ros.odometry(T0))
    recording = Recording(log.container)
    (timed,) = recording.messages(["/own"])
    assert (type(timed.message), timed.message.angular_radps.tolist()) == (Imu, [0, 0, 1])
    assert f"{own}: decoded by the plug-in of quadlog-beacons 1.0, not by quadlog" in recording.warnings


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("decoder = print", "builtin_function_or_method"),
        ("raise ImportError('no driver here')", "no driver here"),
        ("from quadlog.recordings.plugged import MessageDecoder\ndecoder = MessageDecoder(str, print)", "PointCloud"),
    ],
)
def test_an_object_that_is_no_decoder_is_refused_where_its_type_occurs(install, log, source, words):
    plug_in(install, "odd.Type", source=source)
    log.add("/odom", T0, log.ros.odometry(T0))
    assert detect_roles(Recording(log.container), Topics()).topic("odometry") == "/odom"
    add_json(log, "/odd", "odd.Type")
    with pytest.raises(QuadlogError, match=words):
        detect_roles(Recording(log.container), Topics())


def decoded(message, gives):
    (found,) = interpreter(MessageDecoder(gives, lambda *_: [message]))(None, "/topic")
    return found


def test_every_kind_passes_with_its_types():
    cloud = decoded(PointCloud(None, "lidar", [[1, 2, 3]], ring=[4], offset_ns=[5]), PointCloud)
    assert (cloud.xyz_m.dtype, cloud.ring.dtype, cloud.offset_ns.dtype) == (np.float32, np.uint16, np.int64)
    ranges = decoded(UwbRanges(np.int64(7), np.uint8(2), [], []), UwbRanges)
    assert (ranges.stamp_ns.tolist(), len(ranges.rows)) == ([7], 0)
    odometry = decoded(Odometry(1, "odom", "base", XYZ, 2 * QUAT, XYZ, XYZ), Odometry)
    assert odometry.rows["quat_xyzw"].tolist() == [QUAT.tolist()]
    assert np.isnan(decoded(Imu(1, "imu", None, XYZ, XYZ), Imu).rows["quat_xyzw"]).all()
    transforms = decoded(Transforms(None, (Pose(1, "map", "odom", [1, 2, 3], QUAT),), True), Transforms)
    assert (transforms.rows["position_m"].tolist(), transforms.frames) == ([[1, 2, 3]], ("map", "odom"))


@pytest.mark.parametrize(
    ("message", "gives"),
    [
        (Pose(1, "map", "", XYZ, QUAT), Imu),
        (None, Pose),
        (Pose(1.5, "map", "", XYZ, QUAT), Pose),
        (Pose(2**63, "map", "", XYZ, QUAT), Pose),
        (Pose(1, None, "", XYZ, QUAT), Pose),
        (Pose(1, "map", 7, XYZ, QUAT), Pose),
        (Pose(1, "map", "", XYZ[:2], QUAT), Pose),
        (Pose(1, "map", "", XYZ, None), Pose),
        (Pose(1, "map", "", XYZ, QUAT * np.nan), Pose),
        (Pose(1, "map", "", [0, 1e300, 0], QUAT), Pose),
        (Pose(1, "map", "", ["a", "b", "c"], QUAT), Pose),
        (Odometry(1, "map", "", XYZ * np.nan, QUAT, XYZ, XYZ), Odometry),
        (Transforms(1, (Pose(1, "map", "", XYZ + np.inf, QUAT),), False), Transforms),
        (Transforms(None, (None,), False), Transforms),
        (UwbRanges(1, 0, [1, 2], [1.0]), UwbRanges),
        (UwbRanges(1, 0, 1, 1.0), UwbRanges),
        (UwbRanges(1, "x", [1], [1.0]), UwbRanges),
        (PointCloud(1, "l", np.zeros((4, 2))), PointCloud),
        (PointCloud(1, "l", np.zeros((4, 3)), offset_ns=np.zeros(3)), PointCloud),
    ],
)
def test_an_answer_of_another_kind_or_shape_is_not_decoded(message, gives):
    with pytest.raises(DecodeError):
        decoded(message, gives)


def leave(*_):
    raise SystemExit(0)


def stop(*_):
    raise BaseException("enough")


@pytest.mark.parametrize("decode", [leave, stop, lambda *_: os._exit(0), lambda *_: None])
def test_a_decoder_cannot_end_quadlog_and_gives_something_iterable(decode):
    with pytest.raises(DecodeError):
        interpreter(MessageDecoder(Pose, decode))(None, "/topic")
