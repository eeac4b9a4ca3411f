"""The ground of a cloud without beams: a map of its lowest points, grown outwards from under the lidar.

Measured against Patchwork++ (pypatchworkpp 1.4.1) on the same clouds: the map keeps more of the ground on slopes and in
corridors and claims fewer obstacles that are none. Constants were chosen on seed 100 of
tests.lab.labelled_scans, and are never reported on that seed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inner, kernel
from quadlog.lidar.classified_scan import PointClass, Returns, level_plane
from quadlog.messages import Float, Int

CELL_M, HALF_CELLS = 0.3, 107
_REACH_CELLS = 5
# The first cells: how far off, and how steep from under the lidar. Then: off the plane of the cells before, and steep.
_FIRST_M, _FIRST_RISE_M, _FIRST_SLOPE = 4.0, 0.06, 0.4
_OFF_M, _OFF_PER_M, _STEEPEST, _SLACK_M = 0.05, 0.2, 0.5, 0.05
# What rises in a cell between these heights above its lowest point is a wall; higher up it may be a branch.
_WALL_M, _OVERHANG_M = 0.3, 0.8
# Pulls the plane through few points towards level.
_LEVELLING_M2 = 0.2
_GROUND_M = 0.06


def grow_ground(returns: Returns, floor_m: float) -> Float:
    """Fill height_m of returns that `isolate` labelled, and label the ground.

    Returns (3,) a, b, c of the plane z = a dx + b dy + c through the map, of places from below the lidar;
    floor_m: height of the ground there.
    """
    label = returns.label
    middle = np.arange(2 * HALF_CELLS) - HALF_CELLS + 0.5
    outwards = np.argsort((middle[:, None] ** 2 + middle**2).ravel(), kind="stable")
    cells, known = _grow(returns, floor_m, outwards)
    plane = level_plane(cells[known][:, :3], floor_m)
    _measure(returns, cells, known, plane)
    label[(label == PointClass.OBSTACLE) & (np.abs(returns.height_m) <= _GROUND_M)] = PointClass.GROUND
    return plane


@kernel
def _grow(returns: Returns, floor_m: float, order: Int) -> tuple[Float, NDArray[np.bool_]]:
    """Of every ground cell x, y from the lidar, z of its lowest point and the slopes there; and which these are.

    order: all cells, nearest first.
    """
    dx_m, dy_m, z_m, label, size = returns.dx_m, returns.dy_m, returns.z_m, returns.label, 2 * HALF_CELLS
    lowest, cells = np.full((size, size), -1), np.zeros((size, size, 5))
    known, walled = np.zeros((size, size), np.bool_), np.zeros((size, size), np.bool_)
    for finds_walls in (False, True):
        for i in range(len(dx_m)):
            if label[i] != np.uint8(PointClass.OBSTACLE):
                continue
            a, b = math.floor(dx_m[i] / CELL_M) + HALF_CELLS, math.floor(dy_m[i] / CELL_M) + HALF_CELLS
            if not (0 <= a < size and 0 <= b < size):
                continue
            if finds_walls:
                walled[a, b] |= _WALL_M < z_m[i] - z_m[lowest[a, b]] < _OVERHANG_M
            elif lowest[a, b] < 0 or z_m[i] < z_m[lowest[a, b]]:
                lowest[a, b] = i
    for cell in order:
        a, b = cell // size, cell % size
        i = lowest[a, b]
        if i < 0:
            continue
        x, y, z = np.float64(dx_m[i]), np.float64(dy_m[i]), np.float64(z_m[i])
        off, slope_x, slope_y, nearest_m, nearest_z = _extrapolate(cells, known, a, b, x, y)
        if nearest_m < np.inf:
            near_plane = bool(abs(z - off) <= _OFF_M + _OFF_PER_M * nearest_m)
            fits = near_plane and abs(z - nearest_z) <= _STEEPEST * nearest_m + _SLACK_M
        else:
            r = math.sqrt(x * x + y * y)
            # Growth never starts on a wall, which may be visible in part only.
            fits = r < _FIRST_M and not walled[a, b] and abs(z - floor_m) <= _FIRST_RISE_M + _FIRST_SLOPE * r
        if fits:
            cells[a, b, 0], cells[a, b, 1], cells[a, b, 2] = x, y, z
            cells[a, b, 3], cells[a, b, 4] = slope_x, slope_y
            known[a, b] = True
    return cells, known


@inner
def _extrapolate(
    cells: Float, known: NDArray[np.bool_], a: int, b: int, x: float, y: float
) -> tuple[float, float, float, float, float]:
    """Height and slopes at (x, y) of the plane through the known cells about (a, b), and the nearest one's z."""
    n, mx, my, mz = 0.0, 0.0, 0.0, 0.0
    xx, xy, yy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0
    nearest_m, nearest_z = np.inf, 0.0
    for i in range(max(a - _REACH_CELLS, 0), min(a + _REACH_CELLS + 1, len(known))):
        for j in range(max(b - _REACH_CELLS, 0), min(b + _REACH_CELLS + 1, len(known))):
            if not known[i, j]:
                continue
            dx, dy, z = cells[i, j, 0] - x, cells[i, j, 1] - y, cells[i, j, 2]
            away_m = math.sqrt(dx * dx + dy * dy)
            w = 1.0 / (0.3 + away_m)
            n, mx, my, mz = n + w, mx + w * dx, my + w * dy, mz + w * z
            xx, xy, yy = xx + w * dx * dx, xy + w * dx * dy, yy + w * dy * dy
            xz, yz = xz + w * dx * z, yz + w * dy * z
            if away_m < nearest_m:
                nearest_m, nearest_z = away_m, z
    if n == 0.0:
        return 0.0, 0.0, 0.0, nearest_m, nearest_z
    mx, my, mz = mx / n, my / n, mz / n
    xx, yy, xy = xx - n * mx * mx + _LEVELLING_M2, yy - n * my * my + _LEVELLING_M2, xy - n * mx * my
    xz, yz = xz - n * mx * mz, yz - n * my * mz
    size = xx * yy - xy * xy
    slope_x, slope_y = (xz * yy - yz * xy) / size, (yz * xx - xz * xy) / size
    return mz - slope_x * mx - slope_y * my, slope_x, slope_y, nearest_m, nearest_z


@kernel
def _measure(returns: Returns, cells: Float, known: NDArray[np.bool_], plane: Float) -> None:
    """Heights above the cells about each point, the nearer the more; above the plane where none is within 2 m."""
    dx_m, dy_m, z_m, height_m = returns.dx_m, returns.dy_m, returns.z_m, returns.height_m
    for i in range(len(dx_m)):
        if returns.label[i] == np.uint8(PointClass.INVALID):
            continue
        x, y = np.float64(dx_m[i]), np.float64(dy_m[i])
        a, b = math.floor(x / CELL_M) + HALF_CELLS, math.floor(y / CELL_M) + HALF_CELLS
        weight, total = 0.0, 0.0
        for reach in (1, 3, 6):
            for j in range(max(a - reach, 0), min(a + reach + 1, len(known))):
                for k in range(max(b - reach, 0), min(b + reach + 1, len(known))):
                    if known[j, k]:
                        dx, dy = x - cells[j, k, 0], y - cells[j, k, 1]
                        w = 1.0 / (0.01 + dx * dx + dy * dy)
                        weight += w
                        total += w * (cells[j, k, 2] + cells[j, k, 3] * dx + cells[j, k, 4] * dy)
            if weight > 0.0:
                break
        floor = plane[0] * x + plane[1] * y + plane[2]
        height_m[i] = z_m[i] - (total / weight if weight > 0.0 else floor)
