"""sensor_msgs/LaserScan and MultiEchoLaserScan: a planar scanner's sweep, as a cloud of one ring."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache

import numpy as np

from quadlog.errors import DecodeError
from quadlog.messages import Float, PointCloud
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.fields import ColumnReader, Columns
from quadlog.recordings.decoders.payload import Payload
from quadlog.recordings.decoders.ros_messages import Definitions
from quadlog.recordings.decoders.rows import HEADER, Warn

LIMITS = {"low": "range_min", "high": "range_max", "first": "angle_min", "step": "angle_increment"}
LIMITS |= {"pause": "time_increment"}
LASER_SCAN = HEADER | LIMITS | {"range": "ranges[]"}
MULTI_ECHO = HEADER | LIMITS | {"range": "ranges[].echoes[]"}


def scan_decoder(
    wanted: Mapping[str, str], channel: Channel, definitions: Definitions, _: Warn
) -> Callable[[Payload, bool], PointCloud]:
    """As Clouds has it, of the columns that are wanted."""
    reader = ColumnReader(channel, wanted, definitions.candidates)
    return lambda payload, points: laser_scan(reader.one(bytes(payload)), points)


@np.errstate(all="ignore")
def laser_scan(columns: Columns, points: bool) -> PointCloud:
    """A point for each ray, its nearest echo within the scanner's limits, NaN where nothing came back.

    columns: of one message; points: False for a look at the stamp. Raises DecodeError where the rays have no angles.
    """
    low_m, high_m, first_rad, step_rad, pause_s = (float(columns[name][0]) for name in LIMITS)
    arrays = columns.arrays["range"]
    count, stamp_ns, frame = int(columns.lengths[arrays[0]][0]), columns.stamp_ns(), columns.frames()[0]
    if not np.isfinite([first_rad, step_rad]).all() or (step_rad == 0 and count > 1):
        raise DecodeError(columns.topic, f"its {count} ranges have no angles: angle_increment is {step_rad:g}")
    stamp = None if stamp_ns is None else int(stamp_ns[0])
    if not points:
        return PointCloud(stamp, frame, np.empty((0, 3), np.float32))
    range_m = columns["range"][0]
    # What lies outside the limits means "nothing", by the message's definition.
    valid = (range_m > 0) & (range_m >= low_m) & (range_m <= (high_m if high_m > 0 else np.inf)) & np.isfinite(range_m)
    there_m = np.where(valid, range_m, np.nan)
    if len(arrays) > 1:
        ray, there_m = np.repeat(np.arange(count), columns.lengths[arrays[-1]]), np.full(count, np.nan)
        np.fmin.at(there_m, ray[valid], range_m[valid])
    xyz_m = np.zeros((count, 3), np.float32)
    xyz_m[:, :2] = there_m[:, None] * _directions(count, first_rad, step_rad)
    xyz_m[np.isnan(there_m), 2] = np.nan
    # 0 where the scanner does not say; the stamp is the first ray's.
    times = {"time_increment": np.arange(count) * pause_s} if pause_s != 0 and np.isfinite(pause_s) else {}
    return PointCloud(stamp, frame, xyz_m, np.zeros(count, np.uint16), time_fields=times)


@lru_cache(maxsize=8)
def _directions(count: int, first_rad: float, step_rad: float) -> Float:
    angle_rad = first_rad + step_rad * np.arange(count)
    return np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])
