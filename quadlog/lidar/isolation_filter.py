"""The isolation filter on the range image: a return without neighbours at a similar range is an outlier."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inner, kernel
from quadlog.lidar.range_image import Image
from quadlog.messages import Float32

WINDOW, ROWS, SUPPORTERS = 4, 2, 2
NEAR_M, NEAR_PER_M = np.float32(0.10), np.float32(0.025)
"""Supporters lie within NEAR_M + NEAR_PER_M r, WINDOW columns and, where the own row has too few, ROWS rows.

Chosen on seed 100 of quadlog.simulation.synthetic.labelled_scans; never reported on that seed.
"""
_HALF = np.float32(0.5)
# Returns of one surface, four standard deviations of a range apart at most, are averaged.
_SAME_SURFACE_M = np.float32(0.08)
# Range of an empty cell in comparisons: far from every other.
_FAR_OFF_M = np.float32(-1e6)


@inner
def supported(image: Image, row: int, column: int, r: float) -> bool:
    """Whether SUPPORTERS returns about a cell lie near range r, or two at its sides that a straight line joins.

    The line is what ground looks like far away, where the range changes fast along the beam. The cell's own two
    returns do not count.
    """
    range_m, rows, columns = image.range_m, image.rows, image.columns
    near_m = NEAR_M + NEAR_PER_M * r
    for k in range(1, WINDOW + 1):
        a = column - k if column >= k else column - k + columns
        b = column + k if column + k < columns else column + k - columns
        left, right = range_m[0, row * columns + a], range_m[0, row * columns + b]
        if left > 0 and right > 0 and abs(_HALF * (left + right) - r) <= near_m:
            return True
    found = 0
    for layer in range(2 if image.n_others > 0 else 1):
        for i in range(row - ROWS, row + ROWS + 1):
            if i < 0 or i >= rows:
                continue
            c = column - WINDOW if column >= WINDOW else column - WINDOW + columns
            for _ in range(2 * WINDOW + 1):
                other = range_m[layer, i * columns + c]
                if other > 0 and abs(other - r) <= near_m and (c != column or i != row):
                    found += 1
                c = c + 1 if c + 1 < columns else 0
        if found >= SUPPORTERS:
            return True
    return False


class Isolated(NamedTuple):
    """What the filter leaves of an image, (rows, columns) each.

    good: int8, 1 where a return is supported. distance_m (horizontal, from below the lidar), z_m (in base): of smoothed
    ranges, each the mean of those of the same surface within the window: a third of the noise, so that slopes between
    beams are significant.
    """

    good: NDArray[np.int8]
    distance_m: Float32
    z_m: Float32


@kernel
def isolate(image: Image, lidar_z: float) -> Isolated:
    """The filter; lidar_z: the lidar's own height in base, float32."""
    one, none = np.float32(1), np.float32(0)
    rows, columns = image.rows, image.columns
    good, wide = np.empty((rows, columns), np.int8), np.empty(columns + 2 * WINDOW, np.float32)
    distance_m, z_m = np.empty((rows, columns), np.float32), np.empty((rows, columns), np.float32)
    raw_distance = np.empty(columns, np.float32)
    for row in range(rows):
        begin = row * columns
        # An index the compiler cannot see to be positive would keep the loops from becoming vector instructions.
        ranges, raw_z = image.range_m[0, begin:], image.held.z_m[begin:]
        dxs, dys = image.held.dx_m[begin:], image.held.dy_m[begin:]
        for c in range(columns):
            r = ranges[c]
            wide[WINDOW + c] = r if r > none else _FAR_OFF_M
        for k in range(WINDOW):
            wide[k], wide[WINDOW + columns + k] = wide[columns + k], wide[WINDOW + k]
        here, distance, z = good[row], distance_m[row], z_m[row]
        for c in range(columns):
            dx, dy = dxs[c], dys[c]
            raw_distance[c] = np.sqrt(dx * dx + dy * dy)
        # Without branches, so that it becomes vector instructions; LLVM unrolls the inner loop.
        for c in range(columns):
            r = wide[c + WINDOW]
            near_m = NEAR_M + NEAR_PER_M * r
            found, same, total = none, none, none
            for k in range(2 * WINDOW + 1):
                apart = wide[c + k] - r
                found += one if abs(apart) <= near_m else none
                alike = abs(apart) <= _SAME_SURFACE_M
                same += one if alike else none
                total += apart if alike else none
            scale = one + total / (same * r)
            distance[c] = raw_distance[c] * scale if r > none else none
            z[c] = lidar_z + (raw_z[c] - lidar_z) * scale if r > none else none
            # The return itself is among those found.
            here[c] = np.int8((r > none) & (found > SUPPORTERS))
        for c in range(columns):
            if here[c] == 0 and wide[c + WINDOW] > none:
                here[c] = supported(image, row, c, wide[c + WINDOW])
    return Isolated(good, distance_m, z_m)
