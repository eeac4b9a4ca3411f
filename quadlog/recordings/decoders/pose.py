"""PoseStamped, PoseWithCovarianceStamped and TransformStamped: all become a Pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from quadlog.errors import DecodeError
from quadlog.geometry import FARTHEST_M
from quadlog.messages import Float, Pose
from quadlog.recordings.columns import Columns, reachable_rows, stamps_ns, unit_rows
from quadlog.recordings.decoders.stamps import frame_id, frame_name, stamp_ns
from quadlog.recordings.payload_layout import TEXT, each_of, header_of

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
