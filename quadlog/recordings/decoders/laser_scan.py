"""sensor_msgs/LaserScan and MultiEchoLaserScan: a planar scanner's sweep, as a cloud of one ring."""

from __future__ import annotations

from typing import Any

import numpy as np

from quadlog.errors import DecodeError
from quadlog.messages import Float, PointCloud
from quadlog.recordings.decoders.payload import frame_id, stamp_ns


def decode_laser_scan(message: Any, topic: str) -> PointCloud:
    """A point for each ray, NaN where nothing came back. Raises DecodeError where the rays have no angles."""
    return _cloud(message, topic, np.asarray(message.ranges, dtype=np.float64))


def decode_multi_echo_laser_scan(message: Any, topic: str) -> PointCloud:
    """The same of the nearest echo of each ray that lies within the scanner's limits."""
    nearest_m = [_nearest(np.asarray(each.echoes, dtype=np.float64), message) for each in message.ranges]
    return _cloud(message, topic, np.array(nearest_m, dtype=np.float64))


def _nearest(echoes_m: Float, message: Any) -> float:
    valid_m = echoes_m[_returned(echoes_m, message)]
    return float(valid_m.min()) if len(valid_m) else np.nan


def _returned(range_m: Float, message: Any) -> np.ndarray:
    """Which ranges are of something: what lies outside the limits means "nothing", by the message's definition."""
    farthest_m = message.range_max if message.range_max > 0 else np.inf
    return (range_m > 0) & (range_m >= message.range_min) & (range_m <= farthest_m) & np.isfinite(range_m)


def _cloud(message: Any, topic: str, range_m: Float) -> PointCloud:
    count, step_rad = len(range_m), float(message.angle_increment)
    if not np.isfinite([message.angle_min, step_rad]).all() or (step_rad == 0 and count > 1):
        raise DecodeError(topic, f"its {count} ranges have no angles: angle_increment is {step_rad:g}")
    angle_rad = message.angle_min + step_rad * np.arange(count)
    there_m = np.where(_returned(range_m, message), range_m, np.nan)
    xyz_m = np.zeros((count, 3), np.float32)
    xyz_m[:, 0], xyz_m[:, 1] = there_m * np.cos(angle_rad), there_m * np.sin(angle_rad)
    xyz_m[np.isnan(there_m), 2] = np.nan
    ring = np.zeros(count, np.uint16)
    step = float(message.time_increment)  # 0 where the scanner does not tell; the stamp is the first ray's
    times = {"time_increment": np.arange(count) * step} if step != 0 and np.isfinite(step) else {}
    return PointCloud(stamp_ns(message), frame_id(message), xyz_m, ring, time_fields=times)
