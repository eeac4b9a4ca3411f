"""A scan's points by direction and range, for what is found out about a sensor once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadlog.messages import Float32


class Polar(NamedTuple):
    """range_m: (N,) from the lidar, 0 for no return. sine: (N,) of the elevation; turn: (N,) azimuth, [0, 1)."""

    range_m: Float32
    sine: Float32
    turn: Float32


def to_polar(xyz_m: tuple[Float32, Float32, Float32], ranges_m: tuple[float, float]) -> Polar:
    """Points x, y, z (N,) by direction; only ranges from the least to the most of ranges_m are returns."""
    x_m, y_m, z_m = xyz_m
    with np.errstate(all="ignore"):
        squared = x_m * x_m + y_m * y_m + z_m * z_m
        real = (squared > 0) & (squared >= np.float32(ranges_m[0] ** 2)) & (squared <= np.float32(ranges_m[1] ** 2))
        range_m = np.where(real, np.sqrt(squared), np.float32(0))
        sine = np.where(real, z_m / range_m, np.float32(0))
        turn = np.where(real, np.arctan2(y_m, x_m) * np.float32(0.5 / np.pi), np.float32(0))
    turn = np.where(turn < 0, turn + np.float32(1), turn)
    return Polar(range_m, sine, np.where(turn < 1, turn, np.float32(0)))
