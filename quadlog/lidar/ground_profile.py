"""The ground's height around the lidar by sector and distance: what heights above the ground are measured from."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.lidar.points import columns_of
from quadlog.messages import Float, Float32

SECTOR_COLUMNS = 16
"""About 3 degrees: at 10 m as wide as the ground may curve, and few enough returns to average."""
STEP_M, REACH_M = 0.125, 32.0
_SECTORS_BESIDE, _FEWEST = 3, 3


def level_plane(ground: NDArray[np.bool_], xyz_base_m: Float32, point: NDArray[np.int32]) -> Float:
    """(3,) a, b, c of the plane z = a x + b y + c nearest in height to the ground's points, every fourth of them.

    A slight pull towards level through base's origin keeps it defined when there are few points or all in a line.
    """
    squares, mixed = np.diag([1.0, 1.0, 1e-3]), np.zeros(3)
    _add_up(ground, *columns_of(xyz_base_m), point, squares, mixed)
    plane: Float = np.linalg.solve(squares, mixed)
    return plane


@njit(cache=True, error_model="numpy")
def _add_up(
    ground: NDArray[np.bool_],
    x_m: Float32,
    y_m: Float32,
    z_m: Float32,
    point: NDArray[np.int32],
    squares: Float,
    mixed: Float,
) -> None:
    """The normal equations of the plane, added to squares (3, 3) and mixed (3,)."""
    n, sx, sy, sz, xx, xy, yy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for row in range(ground.shape[0]):
        for c in range(0, ground.shape[1], 4):
            if ground[row, c]:
                i = point[row, c]
                x, y, z = np.float64(x_m[i]), np.float64(y_m[i]), np.float64(z_m[i])
                n, sx, sy, sz = n + 1, sx + x, sy + y, sz + z
                xx, xy, yy, xz, yz = xx + x * x, xy + x * y, yy + y * y, xz + x * z, yz + y * z
    squares[0, 0] += xx
    squares[1, 1] += yy
    squares[2, 2] += n
    squares[0, 1] = squares[1, 0] = xy
    squares[0, 2] = squares[2, 0] = sx
    squares[1, 2] = squares[2, 1] = sy
    mixed[0], mixed[1], mixed[2] = xz, yz, sz


def ground_profile(
    ground: NDArray[np.bool_], distance_m: Float32, z_m: Float32, floor_m: float, outward_slope: Float32
) -> Float32:
    """Height of the ground in base, (sectors, steps), every STEP_M outwards of every SECTOR_COLUMNS columns.

    Straight lines from floor_m under the lidar through the mean of each
    beam's ground in the sector, borrowed from the sectors beside it where it
    has too little; beyond the last, outward_slope (sectors,) goes on.
    """
    sectors = len(outward_slope)
    sums = np.zeros((3, sectors, len(ground)), np.float32)
    profile = np.empty((sectors, int(REACH_M / STEP_M) + 1), np.float32)
    _profile(ground, distance_m, z_m, floor_m, outward_slope, sums, profile)
    return profile


@njit(cache=True, error_model="numpy")
def _profile(
    ground: NDArray[np.bool_],
    distance_m: Float32,
    z_m: Float32,
    floor_m: float,
    outward_slope: Float32,
    sums: Float32,
    profile: Float32,
) -> None:
    rows, columns = ground.shape
    sectors, steps = profile.shape
    for row in range(rows):
        for s in range(sectors):
            count, far, high = np.float32(0), np.float32(0), np.float32(0)
            for c in range(s * SECTOR_COLUMNS, min((s + 1) * SECTOR_COLUMNS, columns)):
                if ground[row, c]:
                    count, far, high = count + np.float32(1), far + distance_m[row, c], high + z_m[row, c]
            sums[0, s, row], sums[1, s, row], sums[2, s, row] = count, far, high
    for s in range(sectors):
        at, step, z = 0.0, 0, floor_m
        for row in range(rows):
            count, far, high = sums[0, s, row], sums[1, s, row], sums[2, s, row]
            for k in range(1, _SECTORS_BESIDE + 1):
                if count >= SECTOR_COLUMNS // 2:
                    break
                for beside in (s - k, s + k):
                    other = (beside + sectors) % sectors
                    count += sums[0, other, row]
                    far += sums[1, other, row]
                    high += sums[2, other, row]
            if count < _FEWEST or far / count <= at:
                continue
            far, high = far / count, high / count
            while step < steps and step * STEP_M <= far:
                profile[s, step] = z + (high - z) * (step * STEP_M - at) / (far - at)
                step += 1
            at, z = far, high
        for rest in range(step, steps):
            profile[s, rest] = z + outward_slope[s] * (rest * STEP_M - at)


@njit(cache=True, error_model="numpy")
def profile_height(profile: Float32, column: int, distance_m: float) -> float:
    """The ground's height at a distance in a column, between its sector's middle and the next."""
    sectors, steps = profile.shape
    # Sectors are a power of two wide; shifts and masks cost nothing, for negative numbers too.
    from_middle = column - SECTOR_COLUMNS // 2
    s = from_middle // SECTOR_COLUMNS
    across = (np.float32(from_middle - s * SECTOR_COLUMNS) + np.float32(0.5)) / np.float32(SECTOR_COLUMNS)
    v = min(distance_m * np.float32(1 / STEP_M), np.float32(steps - 2))
    k = np.uint32(v)
    along = v - np.float32(k)
    a, b = profile[s if s >= 0 else sectors - 1], profile[s + 1 if s + 1 < sectors else 0]
    near, far = a[k] + along * (a[k + 1] - a[k]), b[k] + along * (b[k + 1] - b[k])
    return near + across * (far - near)
