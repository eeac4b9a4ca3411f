"""What a point of a scan can be, and which points may be looked at at all."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.messages import Float, Float32


class PointClass(IntEnum):
    """The class of one point, stored as uint8 (`cloud_samples.npz`)."""

    INVALID = 0
    CROPPED = 1
    OUTLIER = 2
    GROUND = 3
    OBSTACLE = 4


def columns_of(xyz_m: Float) -> tuple[Float32, Float32, Float32]:
    """x, y and z (N,) of points (N, 3), float32 and each side by side in memory; no copy where they lie so already.

    That is how decoders make them: compiled loops over them become vector instructions.
    """
    # What is beyond float32 is infinity, which is no return.
    with np.errstate(over="ignore", invalid="ignore"):
        x_m, y_m, z_m = np.ascontiguousarray(xyz_m.T, dtype=np.float32)
    return x_m, y_m, z_m


def valid_points(xyz_m: Float, min_range_m: float, max_range_m: float) -> NDArray[np.bool_]:
    """Which of the points (N, 3), in the lidar's frame, are returns: (N,) bool.

    Drivers write "no return" as NaN, infinity, (0, 0, 0) or a huge number.
    One of these left in disables the statistical filter or pulls the ground
    plane through the sensor, so all go before anything is computed.
    """
    return _valid_points(xyz_m, float(min_range_m), float(max_range_m))


@njit(cache=True)
def _valid_points(xyz_m: Float, min_range_m: float, max_range_m: float) -> NDArray[np.bool_]:
    # In float64 the square of the largest float32 is still finite, and NaN
    # fails both comparisons: one pass, no overflow, no warnings.
    least, most = min_range_m * min_range_m, max_range_m * max_range_m
    valid = np.empty(len(xyz_m), dtype=np.bool_)
    for i in range(len(xyz_m)):
        x, y, z = np.float64(xyz_m[i, 0]), np.float64(xyz_m[i, 1]), np.float64(xyz_m[i, 2])
        squared = x * x + y * y + z * z
        valid[i] = squared > 0.0 and squared >= least and squared <= most
    return valid


def in_field_of_view(xyz_base_m: Float, field_of_view_deg: float) -> NDArray[np.bool_]:
    """Which of the points (N, 3) lie within a fan of field_of_view_deg about base's x axis: (N,) bool. [Following]"""
    if field_of_view_deg >= 360:
        return np.ones(len(xyz_base_m), dtype=np.bool_)
    half_rad = np.deg2rad(field_of_view_deg) / 2
    # |azimuth| <= half  <=>  sin(half - |azimuth|) >= 0, multiplied by the range: no arctan for every point.
    inside: NDArray[np.bool_] = np.sin(half_rad) * xyz_base_m[:, 0] >= np.cos(half_rad) * np.abs(xyz_base_m[:, 1])
    return inside
