"""The small standard messages, odometry, poses, transforms and IMU, and poses of types that quadlog does not know."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from quadlog.config.schema import Topics
from quadlog.errors import DecodeError
from quadlog.geometry import FARTHEST_M
from quadlog.messages import Imu, Odometry, Pose, Transforms
from quadlog.recordings.decoders.joints import JointOrder
from quadlog.recordings.decoders.poses import own_pose
from quadlog.recordings.decoders.ros_messages import Definitions
from quadlog.recordings.decoding import kinds_of, reader_of
from quadlog.recordings.recording import Recording
from quadlog.recordings.streams import gather
from quadlog.recordings.topics.roles import detect_roles
from tests.lab.decoded import decoded, together

T_NS = 1_700_000_000_000_000_005
TURN = (0.0, 0.0, 0.6, 0.8)


def decode(ros: Any, message: Any, topic: str = "/topic") -> Any:
    (found,) = decoded(ros.channel(topic, message.__msgtype__), ros.serialise(message))
    return found


def messages_at(ros: Any, xyz: tuple[float, ...]) -> list[Any]:
    """One message of every type that holds a position, with xyz as that position."""
    pose, header = ros.pose(xyz, TURN), ros.header(T_NS, "/map")
    odometry = ros.odometry(T_NS, (0, 0, 0), "/map", "/base", (0.5, 0.1, 0.0, 0.0, 0.0, 0.2))
    odometry.pose.pose = pose
    first, moved = (ros.transform(T_NS, "/map", "/base", each, TURN) for each in ((0.0, 0.0, 0.0), xyz))
    return [
        ros.make("geometry_msgs/msg/PoseStamped", header=header, pose=pose),
        ros.make("geometry_msgs/msg/PoseWithCovarianceStamped", header=header, pose__pose=pose),
        odometry,
        moved,
        ros.tf(first, moved),
    ]


def test_poses_and_the_twist_of_odometry(ros: Any) -> None:
    found = [decode(ros, each) for each in messages_at(ros, (1.0, 2.0, 3.0))]
    poses = [each.transforms[-1] if isinstance(each, Transforms) else each for each in found]
    assert [type(each) for each in poses[:4]] == [Pose, Pose, Odometry, Pose]
    assert [each.child_frame_id for each in poses] == ["", "", "base", "base", "base"]
    for pose in poses:
        assert (pose.stamp_ns, pose.frame_id) == (T_NS, "map")
        assert (pose.position_m.tolist(), pose.quat_xyzw.tolist()) == ([1, 2, 3], list(TURN))
    assert (poses[2].linear_mps.tolist(), poses[2].angular_radps.tolist()) == ([0.5, 0.1, 0], [0, 0, 0.2])


def test_a_zero_quaternion_is_no_rotation_and_a_long_one_is_shortened(ros: Any) -> None:
    zero, long, broken = (
        ros.make("geometry_msgs/msg/PoseStamped", pose=ros.pose((0, 0, 0), (x, 0, 0, w)))
        for x, w in ((0, 0), (0, 2), (np.nan, 1))
    )
    assert [decode(ros, each).quat_xyzw.tolist() for each in (zero, long)] == [[0, 0, 0, 1]] * 2
    with pytest.raises(DecodeError, match="not finite"):
        decode(ros, broken)


@pytest.mark.parametrize(("topic", "static"), [("/tf", False), ("/tf_static", True), ("/robot/tf_static", True)])
def test_tf(both_ros: Any, topic: str, static: bool) -> None:
    ros = both_ros.cdr
    ends = (("map", "odom", 5), ("odom", "base", 7))
    message = ros.tf(*(ros.transform(t_ns, parent, child, (1.0, 2.0, 3.0), TURN) for parent, child, t_ns in ends))
    found = decode(ros, message, topic)
    assert isinstance(found, Transforms)
    assert (found.static, found.stamp_ns) == (static, 5)
    assert [each.child_frame_id for each in found.transforms] == ["odom", "base"]
    assert decoded(ros.channel(topic, "tf2_msgs/msg/TFMessage"), ros.serialise(ros.tf())) == ()


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.01 * FARTHEST_M])
def test_a_position_that_cannot_be_is_not_decoded(ros: Any, value: float) -> None:
    for place in range(3):
        xyz = tuple(value if i == place else 0.0 for i in range(3))
        for message in messages_at(ros, xyz):
            with pytest.raises(DecodeError, match="position is not finite, or beyond"):
                decode(ros, message)
    for message in messages_at(ros, (FARTHEST_M, -FARTHEST_M, 0.0)):
        decode(ros, message)


@pytest.mark.parametrize(
    ("quaternion", "first_covariance", "oriented"),
    [(TURN, 0.01, True), (TURN, -1.0, False), ((0.0, 0.0, 0.0, 0.0), 0.0, False)],
)
def test_imu(ros: Any, quaternion: tuple[float, ...], first_covariance: float, oriented: bool) -> None:
    values = {"orientation": ros.vector(*quaternion, name="Quaternion"), "linear_acceleration__z": 9.81}
    values |= {
        "orientation_covariance": [first_covariance, *np.zeros(8)],
        "angular_velocity": ros.vector(0.1, 0.2, 0.3),
    }
    message = ros.make("sensor_msgs/msg/Imu", **values)
    imu = decode(ros, message)
    assert isinstance(imu, Imu)
    assert (imu.quat_xyzw is not None) is oriented
    assert imu.angular_radps.tolist() == [0.1, 0.2, 0.3]
    assert imu.linear_mps2.tolist() == [0, 0, 9.81]


def test_points_and_flat_poses(ros: Any) -> None:
    place = ros.vector(1, 2, 3, name="Point")
    point = ros.make("geometry_msgs/msg/PointStamped", header=ros.header(T_NS, "/site"), point=place)
    found = decode(ros, point)
    assert (found.stamp_ns, found.frame_id, found.position_m.tolist()) == (T_NS, "site", [1, 2, 3])
    assert found.quat_xyzw.tolist() == [0, 0, 0, 1]
    flat = decode(ros, ros.make("geometry_msgs/msg/Pose2D", x=1, y=2, theta=np.pi / 2))
    assert (flat.stamp_ns, flat.position_m.tolist()) == (None, [1, 2, 0])
    np.testing.assert_allclose(flat.quat_xyzw, [0, 0, 0.5**0.5, 0.5**0.5])
    with pytest.raises(DecodeError, match="quaternion is not finite"):
        decode(ros, ros.make("geometry_msgs/msg/Pose2D", theta=np.inf))


@pytest.mark.parametrize("latitude_deg", [-89.0, -33.5, 0.0, 48.25, 71.0])
def test_satellite_fixes_are_metres_from_the_first(ros: Any, latitude_deg: float) -> None:
    """Against the ellipsoid's radii of curvature; what comes later counts from the same place."""
    kind = "sensor_msgs/msg/NavSatFix"

    def payload(north_deg: float, east_deg: float, height_m: float, status: int = 0) -> bytes:
        place = {"latitude": latitude_deg + north_deg, "longitude": 179.9999 + east_deg, "altitude": height_m}
        return ros.serialise(ros.make(kind, header=ros.header(T_NS, "antenna"), status__status=status, **place))

    step_deg, topic = 1e-4, "/fix"  # over the antimeridian
    reader: Any = reader_of(ros.channel(topic, kind), Definitions(), JointOrder())
    without = DecodeError(topic, "it has no fix")
    first = together(topic, reader, [payload(9, 9, 9, -1), payload(np.nan, 0, 9), payload(0, 0, 100.0)])
    assert repr(first[:2]) == repr([without, without])
    later = together(
        topic,
        reader,
        [payload(*step) for step in ((step_deg, 0, 100), (0, 2 * step_deg, 100), (0, 0, 103), (0, 0, np.nan))],
    )
    found = np.array([each[0].position_m for each in (first[2], *later)])  # type: ignore[index, union-attr]
    axis_m, e2, sin = 6378137.0, 0.00669437999014, np.sin(np.radians(latitude_deg))
    normal_m = axis_m / np.sqrt(1 - e2 * sin**2)
    north_m = (normal_m**3 * (1 - e2) / axis_m**2 + 100) * np.radians(step_deg)
    east_m = (normal_m + 100) * np.sqrt(1 - sin**2) * np.radians(2 * step_deg)
    np.testing.assert_allclose(found, [[0, 0, 0], [0, north_m, 0], [east_m, 0, 0], [0, 0, 3], [0, 0, -100]], atol=1e-3)
    pose = first[2][0]  # type: ignore[index]
    assert (pose.frame_id, pose.child_frame_id, pose.stamp_ns) == ("east_north_up", "", T_NS)  # type: ignore[union-attr]


VICON = "string name\nfloat32 x_trans\nfloat64 y_trans\nfloat64 z_trans\nTurn turn\nbuiltin_interfaces/Time stamp\n"


def test_poses_of_any_message(ros: Any) -> None:
    """By the names of their fields, in mm, with or without an orientation; the stamp may lie at the top."""
    name, turn = "vicon/msg/Position", "vicon/msg/Turn"
    ros.store.register(get_types_from_msg("float64 w\nfloat64 x\nfloat64 y\nfloat64 z\n", turn))
    ros.store.register(get_types_from_msg(VICON, name))
    values = {"x_trans": 1000, "y_trans": 2000, "z_trans": -500, "turn__w": 0.8, "turn__z": 0.6}
    message = ros.make(name, stamp=ros.stamp(T_NS), **values)
    channel, payload = ros.channel("/vicon", name), ros.serialise(message)
    place, rest = ["x_trans", "y_trans", "z_trans"], [f"turn.{axis}" for axis in "xyzw"]
    for fields, xyzw in ((place, [0, 0, 0, 1]), (place + rest, [0, 0, 0.6, 0.8])):
        (pose,) = decoded(channel, payload, mapped={"/vicon": own_pose(fields, "mm")})
        assert isinstance(pose, Pose)
        assert (pose.stamp_ns, pose.position_m.tolist(), pose.quat_xyzw.tolist()) == (T_NS, [1, 2, -0.5], xyzw)
    with pytest.raises(DecodeError, match="no number z_tran "):
        decoded(channel, payload, mapped={"/vicon": own_pose([*place[:2], "z_tran"])})


XYZ, TILTED = (1.0, -2.0, 0.5), (0.0, 0.6, 0.0, 0.8)
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
    pose, header = ros.pose(XYZ, TILTED), ros.header(T_NS, "/world")
    transform = ros.transform(T_NS, "/world", "", XYZ, TILTED).transform
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
        np.testing.assert_allclose(pose.quat_xyzw, TILTED)


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
