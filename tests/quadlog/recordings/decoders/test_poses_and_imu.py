"""The small standard messages: odometry, poses, transforms, IMU."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from quadlog.errors import DecodeError
from quadlog.geometry import FARTHEST_M
from quadlog.messages import Imu, Odometry, Pose, Transforms
from tests.lab.decoded import decoded

T_NS = 1_700_000_000_000_000_005
TURN = (0.0, 0.0, 0.6, 0.8)


def decode(ros: Any, message: Any, topic: str = "/topic") -> Any:
    (found,) = decoded(ros.channel(topic, message.__msgtype__), ros.serialise(message))
    return found


def messages_at(ros: Any, xyz: tuple[float, ...]) -> list[Any]:
    """One message of every type that holds a position, with xyz as that position."""
    pose, no_covariance = ros.pose(xyz, TURN), np.zeros(36)
    with_covariance = ros.type("geometry_msgs/msg/PoseWithCovariance")(pose, no_covariance)
    velocity = ros.type("geometry_msgs/msg/Twist")(ros.vector(0.5, 0.1, 0.0), ros.vector(0.0, 0.0, 0.2))
    twist = ros.type("geometry_msgs/msg/TwistWithCovariance")(velocity, no_covariance)
    first, moved = (ros.transform(T_NS, "/map", "/base", each, TURN) for each in ((0.0, 0.0, 0.0), xyz))
    return [
        ros.type("geometry_msgs/msg/PoseStamped")(ros.header(T_NS, "/map"), pose),
        ros.type("geometry_msgs/msg/PoseWithCovarianceStamped")(ros.header(T_NS, "/map"), with_covariance),
        ros.type("nav_msgs/msg/Odometry")(ros.header(T_NS, "/map"), "/base", with_covariance, twist),
        moved,
        *([ros.tf(first, moved)] if ros.encoding == "cdr" else []),
    ]


def test_poses_and_the_twist_of_odometry(ros: Any) -> None:
    found = [decode(ros, each) for each in messages_at(ros, (1.0, 2.0, 3.0))]
    poses = [each.transforms[-1] if isinstance(each, Transforms) else each for each in found]
    assert [type(each) for each in poses[:4]] == [Pose, Pose, Odometry, Pose]
    assert [each.child_frame_id for each in poses] == ["", "", "base", "base", "base"][: len(poses)]
    for pose in poses:
        assert (pose.stamp_ns, pose.frame_id) == (T_NS, "map")
        assert (pose.position_m.tolist(), pose.quat_xyzw.tolist()) == ([1, 2, 3], list(TURN))
    assert (poses[2].linear_mps.tolist(), poses[2].angular_radps.tolist()) == ([0.5, 0.1, 0], [0, 0, 0.2])


def test_a_zero_quaternion_is_no_rotation_and_a_long_one_is_shortened(ros: Any) -> None:
    kind = ros.type("geometry_msgs/msg/PoseStamped")
    zero = decode(ros, kind(ros.header(T_NS), ros.pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))))
    assert zero.quat_xyzw.tolist() == [0, 0, 0, 1]
    long = decode(ros, kind(ros.header(T_NS), ros.pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0))))
    assert long.quat_xyzw.tolist() == [0, 0, 0, 1]
    with pytest.raises(DecodeError, match="not finite"):
        decode(ros, kind(ros.header(T_NS), ros.pose((0.0, 0.0, 0.0), (np.nan, 0.0, 0.0, 1.0))))


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
    covariance = np.array([first_covariance, *np.zeros(8)])
    message = ros.type("sensor_msgs/msg/Imu")(
        ros.header(T_NS, "imu"),
        ros.type("geometry_msgs/msg/Quaternion")(*quaternion),
        covariance,
        ros.vector(0.1, 0.2, 0.3),
        np.zeros(9),
        ros.vector(0.0, 0.0, 9.81),
        np.zeros(9),
    )
    imu = decode(ros, message)
    assert isinstance(imu, Imu)
    assert (imu.quat_xyzw is not None) is oriented
    assert imu.angular_radps.tolist() == [0.1, 0.2, 0.3]
    assert imu.linear_mps2.tolist() == [0, 0, 9.81]
