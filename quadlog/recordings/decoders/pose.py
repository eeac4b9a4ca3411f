"""Poses, odometry, transforms and IMU readings of ROS messages, one at a time or by columns; positions and attitudes
that are not finite or out of reach are refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from quadlog.errors import DecodeError
from quadlog.geometry import FARTHEST_M
from quadlog.messages import Float, Imu, Odometry, Pose, Transforms
from quadlog.recordings.decoders.columns import TEXT, Columns, each_of, header_of, reachable_rows, stamps_ns, unit_rows
from quadlog.recordings.decoders.payload import frame_id, frame_name, stamp_ns

POSE_STAMPED = header_of("header") | each_of("pose.position", "xyz") | each_of("pose.orientation", "xyzw")
POSE_WITH_COVARIANCE = (
    header_of("header") | each_of("pose.pose.position", "xyz") | each_of("pose.pose.orientation", "xyzw")
)
TRANSFORM_STAMPED = (
    header_of("header")
    | {"child_frame_id": TEXT}
    | each_of("transform.translation", "xyz")
    | each_of("transform.rotation", "xyzw")
)


def decode_pose_stamped(message: Any, topic: str) -> Pose:
    """geometry_msgs/PoseStamped; the message does not name what it is the pose of."""
    return _pose(message, "", message.pose.position, message.pose.orientation, topic)


def decode_pose_with_covariance(message: Any, topic: str) -> Pose:
    """geometry_msgs/PoseWithCovarianceStamped, its covariance left out."""
    return _pose(message, "", message.pose.pose.position, message.pose.pose.orientation, topic)


def decode_transform(message: Any, topic: str) -> Pose:
    """geometry_msgs/TransformStamped: the pose of child_frame_id in the header's frame."""
    return _pose(
        message,
        frame_name(message.child_frame_id),
        message.transform.translation,
        message.transform.rotation,
        topic,
    )


def pose_in_columns(texts: tuple[str, ...], numbers: Float) -> tuple[list[Columns], np.ndarray]:
    """The same of the numbers (N, 9) of POSE_STAMPED, POSE_WITH_COVARIANCE or TRANSFORM_STAMPED."""
    quat_xyzw, sound = unit_rows(numbers[:, 5:])
    values = np.concatenate([numbers[:, 2:5], quat_xyzw], axis=1)
    frames = [frame_name(text) for text in texts]
    return [Columns(Pose, stamps_ns(numbers[:, :2]), values, *frames)], sound & reachable_rows(values[:, :3])


def _pose(message: Any, child: str, position: Any, orientation: Any, topic: str) -> Pose:
    position_m, quat_xyzw = place(position, topic), unit_quaternion(orientation, topic)
    return Pose(stamp_ns(message), frame_id(message), child, position_m, quat_xyzw)


def vector(xyz: Any) -> Float:
    """(3,) float64 of a Vector3: a rate, a velocity, an acceleration."""
    return np.array([xyz.x, xyz.y, xyz.z], np.float64)


def place(xyz: Any, topic: str) -> Float:
    """(3,) float64 of a position with fields x, y, z; see within_reach."""
    return np.array(within_reach(xyz.x, xyz.y, xyz.z, topic), np.float64)


def within_reach(x: float, y: float, z: float, topic: str) -> tuple[float, float, float]:
    """The same position in metres. Raises DecodeError for one that is not finite or farther out than FARTHEST_M."""
    # NaN fails every comparison.
    if -FARTHEST_M <= x <= FARTHEST_M and -FARTHEST_M <= y <= FARTHEST_M and -FARTHEST_M <= z <= FARTHEST_M:
        return x, y, z
    raise DecodeError(topic, f"its position is not finite, or beyond {FARTHEST_M:.0e} m")


def unit_quaternion(xyzw: Any, topic: str) -> Float:
    """(4,) unit quaternion of a message with fields x, y, z, w; see normalised."""
    return normalised((xyzw.x, xyzw.y, xyzw.z, xyzw.w), topic)


def normalised(xyzw: Sequence[float], topic: str) -> Float:
    """(4,) the quaternion at unit length; all zeros, which many trackers send for "no orientation", is no rotation."""
    x, y, z, w = xyzw
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not math.isfinite(length):
        raise DecodeError(topic, "its quaternion is not finite")
    unit = (x / length, y / length, z / length, w / length) if length > 0 else (0.0, 0.0, 0.0, 1.0)
    return np.array(unit, np.float64)


ODOMETRY = (
    header_of("header")
    | {"child_frame_id": TEXT}
    | each_of("pose.pose.position", "xyz")
    | each_of("pose.pose.orientation", "xyzw")
    | each_of("twist.twist.linear", "xyz")
    | each_of("twist.twist.angular", "xyz")
)


def decode_odometry(message: Any, topic: str) -> Odometry:
    """Pose and twist, their covariances left out."""
    pose, twist = message.pose.pose, message.twist.twist
    return Odometry(
        stamp_ns(message),
        frame_id(message),
        frame_name(message.child_frame_id),
        place(pose.position, topic),
        unit_quaternion(pose.orientation, topic),
        vector(twist.linear),
        vector(twist.angular),
    )


def odometry_in_columns(texts: tuple[str, ...], numbers: Float) -> tuple[list[Columns], np.ndarray]:
    """The same of the numbers (N, 15) of ODOMETRY."""
    quat_xyzw, sound = unit_rows(numbers[:, 5:9])
    values = np.concatenate([numbers[:, 2:5], quat_xyzw, numbers[:, 9:]], axis=1)
    frame, child = (frame_name(text) for text in texts)
    return [Columns(Odometry, stamps_ns(numbers[:, :2]), values, frame, child)], sound & reachable_rows(values[:, :3])


TF = {f"transforms.{path}": count for path, count in TRANSFORM_STAMPED.items()}
_NUMBERS = 9


def decode_tf(message: Any, topic: str) -> Transforms:
    """All transforms of a message; static by the topic's name, as tf2 has it.

    Every transform carries its own stamp; the message's is that of the first, None where it is empty.
    """
    transforms = tuple(decode_transform(each, topic) for each in message.transforms)
    stamp_ns = transforms[0].stamp_ns if transforms else None
    return Transforms(stamp_ns, transforms, is_static(topic))


def is_static(topic: str) -> bool:
    """Whether a topic of transforms carries static ones."""
    return topic.rsplit("/", 1)[-1] == "tf_static"


def tf_in_columns(texts: tuple[str, ...], numbers: Float) -> tuple[list[Columns], np.ndarray]:
    """The same of the numbers of TF: two names and nine numbers for each transform, which has columns of its own."""
    found: list[Columns] = []
    sound = np.ones(len(numbers), dtype=bool)
    for i in range(len(texts) // 2):
        columns, own = pose_in_columns(texts[2 * i : 2 * i + 2], numbers[:, _NUMBERS * i : _NUMBERS * (i + 1)])
        found += columns
        sound &= own
    return found, sound


IMU = (
    header_of("header")
    | each_of("orientation", "xyzw")
    | {"orientation_covariance": 1}
    | each_of("angular_velocity", "xyz")
    | each_of("linear_acceleration", "xyz")
)


def decode_imu(message: Any, topic: str) -> Imu:
    """Rates and accelerations; an orientation only where the sensor has one.

    The message says "none" by orientation_covariance[0] = -1; drivers that
    forget it leave the quaternion at zero.
    """
    given = message.orientation
    absent = message.orientation_covariance[0] == -1 or not any((given.x, given.y, given.z, given.w))
    return Imu(
        stamp_ns(message),
        frame_id(message),
        None if absent else unit_quaternion(given, topic),
        vector(message.angular_velocity),
        vector(message.linear_acceleration),
    )


def imu_in_columns(texts: tuple[str, ...], numbers: Float) -> tuple[list[Columns], np.ndarray]:
    """The same of the numbers (N, 13) of IMU."""
    absent = (numbers[:, 6] == -1) | ~numbers[:, 2:6].any(axis=1)
    quat_xyzw, sound = unit_rows(numbers[:, 2:6])
    quat_xyzw[absent] = np.nan
    values = np.concatenate([numbers[:, 7:10], quat_xyzw], axis=1)
    return [Columns(Imu, stamps_ns(numbers[:, :2]), values, frame_name(texts[0]))], sound | absent
