"""nav_msgs/Odometry."""

from __future__ import annotations

from typing import Any

from quadlog.messages import Odometry
from quadlog.recordings.decoders.pose import unit_quaternion, vector
from quadlog.recordings.decoders.stamps import frame_id, frame_name, stamp_ns


def decode_odometry(message: Any, topic: str) -> Odometry:
    """Pose and twist, their covariances left out."""
    pose, twist = message.pose.pose, message.twist.twist
    return Odometry(
        stamp_ns(message),
        frame_id(message),
        frame_name(message.child_frame_id),
        vector(pose.position),
        unit_quaternion(pose.orientation, topic),
        vector(twist.linear),
        vector(twist.angular),
    )
