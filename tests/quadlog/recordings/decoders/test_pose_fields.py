"""Poses of types that quadlog does not know, found by their definitions; payloads are written by rosbags."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from quadlog.config.schema import Topics
from quadlog.errors import DecodeError
from quadlog.messages import Pose
from quadlog.recordings.decoding import kinds_of
from quadlog.recordings.recording import Recording
from quadlog.recordings.streams import gather
from quadlog.recordings.topics.roles import detect_roles
from tests.lab.decoded import decoded

T_NS = 1_700_000_000_000_000_005
XYZ, TURN = (1.0, -2.0, 0.5), (0.0, 0.6, 0.0, 0.8)
HEADER = "std_msgs/Header header\n"
SUBJECT = "vicon/msg/Subject"
TYPES = {
    SUBJECT: HEADER
    + "string name\nbool occluded\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "lab/msg/Tracked": HEADER + "uint32 id\ngeometry_msgs/PoseWithCovariance where\nfloat64[] residuals\n",
    "lab/msg/Body": "string name\ngeometry_msgs/Transform place\n",
    "lab/msg/Frame": HEADER + "uint32 frame\nBody body\n",
    "lab/msg/Bodies": HEADER + "Body[] bodies\n",
    "lab/msg/Two": HEADER + "geometry_msgs/Pose seen\ngeometry_msgs/Pose wanted\n",
    "lab/msg/Timeless": "geometry_msgs/Pose pose\n",
    "lab/msg/Wrapped": "geometry_msgs/PoseStamped stamped\n",
}


@pytest.fixture
def lab(ros: Any) -> Any:
    for name, text in TYPES.items():
        ros.store.register(get_types_from_msg(text, name))
    return ros


def messages_of(ros: Any, **changed: Any) -> dict[str, Any]:
    """One message with the same pose of every type that holds one."""
    pose, header = ros.pose(XYZ, TURN), ros.header(T_NS, "/world")
    transform = ros.transform(T_NS, "/world", "", XYZ, TURN).transform
    parts: dict[str, dict[str, Any]] = {
        SUBJECT: {"header": header, "position": pose.position, "orientation": pose.orientation} | changed,
        "lab/msg/Tracked": {"header": header, "where__pose": pose, "residuals": [0.5, 0.25]},
        "lab/msg/Frame": {"header": header, "body__place": transform},
        "lab/msg/Wrapped": {"stamped__header": header, "stamped__pose": pose},
    }
    return {name: ros.make(name, **values) for name, values in parts.items()}


def test_the_pose_of_an_unknown_type(lab: Any) -> None:
    for name, message in messages_of(lab).items():
        channel, payload = lab.channel("/topic", name), lab.serialise(message)
        (pose,) = decoded(channel, payload)
        assert isinstance(pose, Pose)
        assert (pose.stamp_ns, pose.frame_id, pose.position_m.tolist()) == (T_NS, "world", list(XYZ))
        np.testing.assert_allclose(pose.quat_xyzw, TURN)


def test_what_a_tracker_does_not_see_is_no_pose(lab: Any) -> None:
    with pytest.raises(DecodeError, match=r"not tracked \(occluded\)"):
        decoded(lab.channel("/topic", SUBJECT), lab.serialise(messages_of(lab, occluded=True)[SUBJECT]))


def test_types_without_one_pose_and_a_header_are_not_taken(lab: Any) -> None:
    others = ("lab/msg/Bodies", "lab/msg/Two", "lab/msg/Timeless", "visualization_msgs/msg/Marker")
    assert not any(kinds_of(lab.channel("/topic", name)) for name in others)


def test_roles_of_unknown_types_are_explained(lab: Any, log: Any) -> None:
    topics = {"/dog": SUBJECT, "/all": "lab/msg/Bodies", "/plan": "lab/msg/Two", "/id": "lab/msg/Frame"}
    messages = messages_of(lab)
    for topic, name in topics.items():
        payload = lab.serialise(messages[name]) if name in messages else b"\0\1\0\0"
        log.container.add(lab.channel(topic, name), T_NS, payload)
    dogs = Recording(log.container)
    roles = detect_roles(dogs, Topics())
    expected = {"/dog": ("reference", SUBJECT), "/all": (None, "bodies"), "/plan": (None, "seen, wanted")}
    for topic, (role, words) in (expected | {"/id": (None, "--set topics.reference=/id")}).items():
        found, why = roles.of_topic(topic)
        assert (found, words in why) == (role, True)
    series = gather(dogs, reference="/id").reference
    assert series is not None
    np.testing.assert_allclose(series.position_m, [XYZ])
