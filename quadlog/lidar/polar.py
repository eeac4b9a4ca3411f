"""A scan's points by direction and range: the one pass that reads the cloud as it came."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.messages import Float

Float32 = NDArray[np.float32]


class Polar(NamedTuple):
    """N points; all of an invalid one is NaN in xyz_base_m and 0 elsewhere.

    xyz_base_m: (N, 3) in base. range_m: (N,) from the lidar, 0 where invalid.
    sine: (N,) of the elevation in the lidar's frame; turn: (N,) azimuth in that frame in turns, [0, 1).
    """

    xyz_base_m: Float32
    range_m: Float32
    sine: Float32
    turn: Float32


def to_polar(xyz_m: Float, transform: Float, min_range_m: float, max_range_m: float) -> Polar:
    """Points (N, 3) in the lidar's frame by direction, and moved to base; the rule of `valid_points` drops no-returns.

    The arctangent is a polynomial of degree 9 (Abramowitz and Stegun 4.4.49, error below 1e-5 rad): a hundredth of
    the step between two columns of any spinning lidar.
    """
    n = len(xyz_m)
    polar = Polar(np.empty((n, 3), np.float32), *(np.zeros(n, np.float32) for _ in range(3)))
    _fill(xyz_m, transform, float(min_range_m) ** 2, float(max_range_m) ** 2, *polar)
    return polar


# Everywhere in this method the compiled functions are given the arrays they fill: to allocate one inside takes longer
# to compile than the loop that fills it.
@njit(cache=True, error_model="numpy")
def _fill(
    xyz_m: Float,
    transform: Float,
    least: float,
    most: float,
    moved: Float32,
    range_m: Float32,
    sine: Float32,
    turn: Float32,
) -> None:
    for i in range(len(xyz_m)):
        x, y, z = np.float64(xyz_m[i, 0]), np.float64(xyz_m[i, 1]), np.float64(xyz_m[i, 2])
        squared = x * x + y * y + z * z
        if not (squared > 0.0 and squared >= least and squared <= most):
            for k in range(3):
                moved[i, k] = np.nan
            continue
        r = math.sqrt(squared)
        range_m[i], sine[i] = r, z / r
        for k in range(3):
            moved[i, k] = transform[k, 0] * x + transform[k, 1] * y + transform[k, 2] * z + transform[k, 3]
        size_x, size_y = abs(x), abs(y)
        steep = size_y > size_x
        larger, smaller = (size_y, size_x) if steep else (size_x, size_y)
        q = smaller / larger if larger > 0.0 else 0.0
        s = q * q
        rad = q * (0.9998660 + s * (-0.3302995 + s * (0.1801410 + s * (-0.0851330 + s * 0.0208351))))
        part = rad * (0.5 / math.pi)
        if steep:
            part = 0.25 - part
        if x < 0.0:
            part = 0.5 - part
        if y < 0.0:
            part = 1.0 - part
        # Rounding to float32 may reach 1, which is 0.
        turn[i] = part if part < 0.9999999 else 0.0
