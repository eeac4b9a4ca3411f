"""nav_msgs/Odometry."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadlog.messages import Odometry
from quadlog.recordings.decoders.pose import place, unit, unit_quaternion, vector, within_reach
from quadlog.recordings.decoders.stamps import frame_id, frame_name, nanoseconds, stamp_ns
from quadlog.recordings.plain_fields import TEXT, each_of, header_of
from quadlog.recordings.plain_messages import Values

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


def odometry_of_values(values: Values, topic: str) -> Odometry:
    """The values of ODOMETRY."""
    (frame, child), (seconds, nanos, x, y, z, qx, qy, qz, qw, *twist) = values
    numbers = np.array((*within_reach(x, y, z, topic), *unit(qx, qy, qz, qw, topic), *twist), np.float64)
    return Odometry(
        nanoseconds(seconds, nanos),
        frame_name(frame),
        frame_name(child),
        numbers[:3],
        numbers[3:7],
        numbers[7:10],
        numbers[10:],
    )
