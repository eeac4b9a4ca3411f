"""The ground of a cloud without beams: a map of its lowest points, grown outwards from under the lidar.

Measured against Patchwork++ (pypatchworkpp 1.4.1) on the same clouds: the map
keeps more of the ground on slopes and in corridors and claims fewer obstacles
that are none. Constants were chosen on seed 100 of
quadlog.simulation.labelled_scans, and are never reported on that seed.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from quadlog.lidar.beams import beams_by_bins
from quadlog.lidar.image import range_image
from quadlog.lidar.isolation import BOTH_LAYERS, isolate, supported
from quadlog.lidar.points import PointClass
from quadlog.lidar.polar import Polar
from quadlog.messages import Float, Float32, Int

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


def classify_unorganised(polar: Polar, transform: Float, floor_m: float) -> tuple[NDArray[np.uint8], Float32, Float]:
    """Class and height (N,) of the points, and (3,) a, b, c of the plane z = a x + b y + c through the map.

    polar: by directions along base's axes from the lidar's place, which is
    transform's translation; floor_m: height of the ground below it.
    """
    x_m, y_m, z_m = (float(each) for each in transform[:3, 3])
    image = range_image(polar, beams_by_bins(polar), x_m, y_m)
    good, _, _ = isolate(image, z_m)
    label, height_m = np.empty(len(polar.range_m), np.uint8), np.full(len(polar.range_m), np.nan, np.float32)
    drop_isolated(polar.range_m, image.range_m, image.cell, image.point, good, label)
    size = 2 * HALF_CELLS
    lowest, cells, known = np.full((size, size), -1), np.zeros((size, size, 5)), np.zeros((size, size), np.bool_)
    walled = np.zeros((size, size), np.bool_)
    _grow(polar.xyz_base_m, label, x_m, y_m, floor_m, _outwards(), lowest, cells, known, walled)
    plane = _plane(cells[known], x_m, y_m, floor_m)
    _measure(polar.xyz_base_m, label, x_m, y_m, cells, known, plane, height_m)
    label[(label == PointClass.OBSTACLE) & (np.abs(height_m) <= _GROUND_M)] = PointClass.GROUND
    return label, height_m, plane


def _outwards() -> Int:
    """All cells, nearest first."""
    middle = np.arange(2 * HALF_CELLS) - HALF_CELLS + 0.5
    order: Int = np.argsort((middle[:, None] ** 2 + middle**2).ravel(), kind="stable")
    return order


def _plane(cells: Float, x_m: float, y_m: float, floor_m: float) -> Float:
    ones = np.column_stack([cells[:, :2], np.ones(len(cells))])
    pull = np.diag([1.0, 1.0, 1e-3])
    a, b, c = np.linalg.solve(ones.T @ ones + pull, ones.T @ cells[:, 2] + pull @ np.array([0.0, 0.0, floor_m]))
    return np.array([a, b, c - a * x_m - b * y_m])


@njit(cache=True, error_model="numpy")
def drop_isolated(
    ranges_m: Float32,
    range_m: Float32,
    cells: NDArray[np.int32],
    point: NDArray[np.int32],
    good: NDArray[np.bool_],
    label: NDArray[np.uint8],
) -> None:
    """Label (N,) what no neighbour supports an outlier, what is no return invalid, and the rest an obstacle."""
    columns = good.shape[1]
    for i in range(len(label)):
        row, c = cells[i] // columns, cells[i] % columns
        if ranges_m[i] == 0:
            label[i] = np.uint8(PointClass.INVALID)
        elif (point[row, c] == i and good[row, c]) or supported(range_m, BOTH_LAYERS, row, c, ranges_m[i]):
            label[i] = np.uint8(PointClass.OBSTACLE)
        else:
            label[i] = np.uint8(PointClass.OUTLIER)


@njit(cache=True, error_model="numpy")
def _grow(
    xyz_m: Float32,
    label: NDArray[np.uint8],
    x_m: float,
    y_m: float,
    floor_m: float,
    order: Int,
    lowest: Int,
    cells: Float,
    known: NDArray[np.bool_],
    walled: NDArray[np.bool_],
) -> None:
    """Of every ground cell x, y from the lidar, z of its lowest point, and the slopes along x and y there."""
    size = len(lowest)
    for i in range(len(xyz_m)):
        if label[i] != np.uint8(PointClass.OBSTACLE):
            continue
        a = math.floor((xyz_m[i, 0] - x_m) / CELL_M) + HALF_CELLS
        b = math.floor((xyz_m[i, 1] - y_m) / CELL_M) + HALF_CELLS
        if 0 <= a < size and 0 <= b < size and (lowest[a, b] < 0 or xyz_m[i, 2] < xyz_m[lowest[a, b], 2]):
            lowest[a, b] = i
    for i in range(len(xyz_m)):
        if label[i] != np.uint8(PointClass.OBSTACLE):
            continue
        a = math.floor((xyz_m[i, 0] - x_m) / CELL_M) + HALF_CELLS
        b = math.floor((xyz_m[i, 1] - y_m) / CELL_M) + HALF_CELLS
        if 0 <= a < size and 0 <= b < size:
            walled[a, b] |= _WALL_M < xyz_m[i, 2] - xyz_m[lowest[a, b], 2] < _OVERHANG_M
    for cell in order:
        a, b = cell // size, cell % size
        i = lowest[a, b]
        if i < 0:
            continue
        x, y, z = xyz_m[i, 0] - x_m, xyz_m[i, 1] - y_m, np.float64(xyz_m[i, 2])
        off, slope_x, slope_y, nearest_m, nearest_z = _extrapolate(cells, known, a, b, x, y)
        if nearest_m < np.inf:
            near_plane = bool(abs(z - off) <= _OFF_M + _OFF_PER_M * nearest_m)
            fits = near_plane and abs(z - nearest_z) <= _STEEPEST * nearest_m + _SLACK_M
        else:
            r = math.sqrt(x * x + y * y)
            # Growth never starts on a wall, of which only a part may be in view.
            fits = r < _FIRST_M and not walled[a, b] and abs(z - floor_m) <= _FIRST_RISE_M + _FIRST_SLOPE * r
        if fits:
            cells[a, b, 0], cells[a, b, 1], cells[a, b, 2] = x, y, z
            cells[a, b, 3], cells[a, b, 4] = slope_x, slope_y
            known[a, b] = True


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def _measure(
    xyz_m: Float32,
    label: NDArray[np.uint8],
    x_m: float,
    y_m: float,
    cells: Float,
    known: NDArray[np.bool_],
    plane: Float,
    height_m: Float32,
) -> None:
    """Heights above the cells about each point, the nearer the more; above the plane where none is within 2 m."""
    for i in range(len(label)):
        if label[i] == np.uint8(PointClass.INVALID):
            continue
        x, y = np.float64(xyz_m[i, 0]) - x_m, np.float64(xyz_m[i, 1]) - y_m
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
        floor = plane[0] * xyz_m[i, 0] + plane[1] * xyz_m[i, 1] + plane[2]
        height_m[i] = xyz_m[i, 2] - (total / weight if weight > 0.0 else floor)
