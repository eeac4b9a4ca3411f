"""nav_msgs/Odometry."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadlog.messages import Float, Odometry
from quadlog.recordings.columns import Columns, reachable_rows, stamps_ns, unit_rows
from quadlog.recordings.decoders.pose import place, unit_quaternion, vector
from quadlog.recordings.decoders.stamps import frame_id, frame_name, stamp_ns
from quadlog.recordings.payload_layout import TEXT, each_of, header_of

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
