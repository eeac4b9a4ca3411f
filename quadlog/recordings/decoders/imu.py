"""sensor_msgs/Imu."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadlog.messages import Imu
from quadlog.recordings.decoders.pose import unit, unit_quaternion, vector
from quadlog.recordings.decoders.stamps import frame_id, frame_name, nanoseconds, stamp_ns
from quadlog.recordings.plain_fields import each_of, header_of
from quadlog.recordings.plain_messages import Values

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


def imu_of_values(values: Values, topic: str) -> Imu:
    """The values of IMU."""
    (frame,), (seconds, nanos, x, y, z, w, covariance, *others) = values
    absent = covariance == -1 or not (x or y or z or w)
    numbers = np.array((*others, *(() if absent else unit(x, y, z, w, topic))), np.float64)
    return Imu(
        nanoseconds(seconds, nanos), frame_name(frame), None if absent else numbers[6:], numbers[:3], numbers[3:6]
    )
