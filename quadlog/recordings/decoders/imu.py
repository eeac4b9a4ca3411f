"""sensor_msgs/Imu."""

from __future__ import annotations

from typing import Any

from quadlog.messages import Imu
from quadlog.recordings.decoders.pose import unit_quaternion, vector
from quadlog.recordings.decoders.stamps import frame_id, stamp_ns


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
