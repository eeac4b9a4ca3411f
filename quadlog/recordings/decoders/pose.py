"""PoseStamped, PoseWithCovarianceStamped and TransformStamped: all become a Pose."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadlog.errors import DecodeError
from quadlog.messages import Float, Pose
from quadlog.recordings.decoders.stamps import frame_id, frame_name, stamp_ns


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


def _pose(message: Any, child: str, position: Any, orientation: Any, topic: str) -> Pose:
    return Pose(stamp_ns(message), frame_id(message), child, vector(position), unit_quaternion(orientation, topic))


def vector(xyz: Any) -> Float:
    """(3,) float64 of a Point or Vector3."""
    return np.array([xyz.x, xyz.y, xyz.z], np.float64)


def unit_quaternion(xyzw: Any, topic: str) -> Float:
    """(4,) unit quaternion of a message with fields x, y, z, w; see normalised."""
    return normalised(np.array([xyzw.x, xyzw.y, xyzw.z, xyzw.w], np.float64), topic)


def normalised(quat_xyzw: Float, topic: str) -> Float:
    """The quaternion at unit length; all zeros, which many trackers send for "no orientation", is no rotation."""
    length = float(np.sqrt(quat_xyzw @ quat_xyzw))
    if not np.isfinite(length):
        raise DecodeError(topic, "its quaternion is not finite")
    return quat_xyzw / length if length > 0 else np.array([0.0, 0.0, 0.0, 1.0])
