"""The ground's height around the lidar by sector and distance: what heights above the ground are measured from."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.lidar.polar import Float32
from quadlog.messages import Float

SECTOR_COLUMNS = 16
"""About 3 degrees: at 10 m as wide as the ground may curve, and few enough returns to average."""
STEP_M, REACH_M = 0.125, 32.0
_SECTORS_BESIDE, _FEWEST = 3, 3


def level_plane(ground: NDArray[np.bool_], xyz_base_m: Float32, point: NDArray[np.int32]) -> Float:
    """(3,) a, b, c of the plane z = a x + b y + c nearest in height to the ground's points, every fourth of them.

    A slight pull towards level through base's origin keeps it defined when there are few points or all in a line.
    """
    xyz_m = xyz_base_m[point[:, ::4][ground[:, ::4]]].astype(np.float64)
    ones = np.column_stack([xyz_m[:, :2], np.ones(len(xyz_m))])
    plane: Float = np.linalg.solve(ones.T @ ones + np.diag([1.0, 1.0, 1e-3]), ones.T @ xyz_m[:, 2])
    return plane


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
        for c in range(columns):
            if ground[row, c]:
                s = c // SECTOR_COLUMNS
                sums[0, s, row] += np.float32(1)
                sums[1, s, row] += distance_m[row, c]
                sums[2, s, row] += z_m[row, c]
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
def profile_height(profile: Float32, column: int, distance: float) -> float:
    """The ground's height at a distance in a column, between its sector's middle and the next."""
    sectors, steps = profile.shape
    u = (column + np.float32(0.5)) / np.float32(SECTOR_COLUMNS) - np.float32(0.5)
    s = int(np.floor(u))
    across = u - s
    v = distance / np.float32(STEP_M)
    if v > steps - 2:
        v = np.float32(steps - 2)
    k = int(v)
    along = v - k
    t = s + 1 if s + 1 < sectors else 0
    a, b = profile[s if s >= 0 else sectors - 1], profile[t]
    near, far = a[k] + along * (a[k + 1] - a[k]), b[k] + along * (b[k + 1] - b[k])
    return near + across * (far - near)
