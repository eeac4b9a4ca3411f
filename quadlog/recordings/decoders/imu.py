"""sensor_msgs/Imu."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadlog.messages import Float, Imu
from quadlog.recordings.decoders.columns import Columns, each_of, header_of, stamps_ns, unit_rows
from quadlog.recordings.decoders.payload import frame_id, frame_name, stamp_ns
from quadlog.recordings.decoders.pose import unit_quaternion, vector

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
