"""The isolation filter on the range image: a return that no neighbouring return lies near is false."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.lidar.image import Image
from quadlog.messages import Float32

WINDOW, ROWS, SUPPORTERS = 4, 2, 2
BOTH_LAYERS: int = np.int64(2)  # type: ignore[assignment]  # a plain 2 would be compiled apart
NEAR_M, NEAR_PER_M = np.float32(0.10), np.float32(0.025)
"""Supporters lie within NEAR_M + NEAR_PER_M r, WINDOW columns and, where the own row has too few, ROWS rows.

Chosen on seed 100 of quadlog.simulation.labelled_scans; never reported on that seed.
"""
_HALF = np.float32(0.5)
# Returns of one surface, four standard deviations of a range apart at most, are averaged.
_SAME_SURFACE_M = np.float32(0.08)


@njit(cache=True, error_model="numpy")
def supported(range_m: Float32, layers: int, row: int, column: int, r: float) -> bool:
    """Whether SUPPORTERS returns about a cell lie near range r, or two at its sides that a straight line joins.

    The line is what ground looks like far away, where the range changes
    fast along the beam. range_m: (2, rows, columns) of `Image`, of which
    `layers` are looked at; the cell's own two returns do not count.
    """
    rows, columns = range_m.shape[1], range_m.shape[2]
    near_m = NEAR_M + NEAR_PER_M * r
    for k in range(1, WINDOW + 1):
        a = column - k if column >= k else column - k + columns
        b = column + k if column + k < columns else column + k - columns
        left, right = range_m[0, row, a], range_m[0, row, b]
        if left > 0 and right > 0 and abs(_HALF * (left + right) - r) <= near_m:
            return True
    found = 0
    for layer in range(layers):
        for i in range(row - ROWS, row + ROWS + 1):
            if i < 0 or i >= rows:
                continue
            c = column - WINDOW if column >= WINDOW else column - WINDOW + columns
            for _ in range(2 * WINDOW + 1):
                other = range_m[layer, i, c]
                if other > 0 and abs(other - r) <= near_m and (c != column or i != row):
                    found += 1
                c = c + 1 if c + 1 < columns else 0
        if found >= SUPPORTERS:
            return True
    return False


def isolate(image: Image, z_m: float) -> tuple[NDArray[np.bool_], Float32, Float32]:
    """Which cells (rows, columns) hold a supported return, and distance_m and z_m of the image with smoothed ranges.

    A range is the mean of those of the same surface within the window: a
    third of the noise, which is what makes slopes between beams tell. z_m is
    the lidar's own height in base.
    """
    shape = image.distance_m.shape
    good = np.zeros(shape, np.bool_)
    distance_m, height_m = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    first = image.range_m[0]
    wide = np.concatenate([first[:, -WINDOW:], first, first[:, :WINDOW]], axis=1)
    counts = np.zeros((3, shape[1]), np.float32)
    _isolate(
        image.range_m,
        wide,
        image.distance_m,
        image.z_m,
        2 if image.doubled else 1,
        z_m,
        counts,
        good,
        distance_m,
        height_m,
    )
    return good, distance_m, height_m


@njit(cache=True, error_model="numpy")
def _isolate(
    range_m: Float32,
    wide_m: Float32,
    raw_distance_m: Float32,
    raw_z_m: Float32,
    layers: int,
    lidar_z_m: float,
    counts: Float32,
    good: NDArray[np.bool_],
    distance_m: Float32,
    z_m: Float32,
) -> None:
    one, none = np.float32(1), np.float32(0)
    lidar_z = np.float32(lidar_z_m)
    found, same, total = counts[0], counts[1], counts[2]
    for row in range(good.shape[0]):
        ranges, wide = range_m[0, row], wide_m[row]
        for c in range(len(ranges)):
            found[c], same[c], total[c] = none, none, none
        for k in range(2 * WINDOW + 1):
            # Without branches, and few arrays each, so that they become vector instructions.
            for c in range(len(ranges)):
                near = abs(wide[c + k] - ranges[c]) <= NEAR_M + NEAR_PER_M * ranges[c]
                found[c] += one if near else none
            for c in range(len(ranges)):
                apart = wide[c + k] - ranges[c]
                alike = abs(apart) <= _SAME_SURFACE_M
                same[c] += one if alike else none
                total[c] += apart if alike else none
        raw_distance, raw_z, distance, z, here = raw_distance_m[row], raw_z_m[row], distance_m[row], z_m[row], good[row]
        for c in range(len(ranges)):
            # The return itself is among those found.
            here[c] = (ranges[c] > none) & (found[c] > SUPPORTERS)
        for c in range(len(ranges)):
            scale = one + total[c] / (same[c] * ranges[c])
            total[c] = scale if ranges[c] > none else one
        for c in range(len(ranges)):
            distance[c] = raw_distance[c] * total[c]
        for c in range(len(ranges)):
            z[c] = lidar_z + (raw_z[c] - lidar_z) * total[c]
        for c in range(len(ranges)):
            if not here[c] and ranges[c] > none:
                here[c] = supported(range_m, layers, row, c, ranges[c])
