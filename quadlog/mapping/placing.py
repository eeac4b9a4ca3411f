"""A classified scan on the grid around the robot: what was hit in each cell, and how low it was seen through.

Nothing in a scan is deskewed: each return carries the time slot in which it was measured, and the pose of that slot
puts it where it was. Rays run from where the lidar was on average. They are gathered by direction: of each sector the
few that count, by reach and slope; every cell of the window takes its height from the sector it lies in, so that none
in sight is left out, however far off it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inner, kernel
from quadlog.lidar.classified_scan import ClassifiedScan, PointClass, Returns
from quadlog.lidar.range_image import turn_of
from quadlog.mapping.grid import Window
from quadlog.messages import Float, Float32

NO_TOP, NO_RAY = np.int16(-32768), np.int16(32767)
"""Height, in mm, of the highest obstacle point in a cell in which nothing was hit; of the lowest ray where none is."""
MOST_SECTORS, FEWEST_SECTORS = 512, 64
"""Number of directions; at the edge of a 20 m window they are about as far apart as a cell of 0.1 m is wide."""
RAYS_IN_SECTOR = 16
"""Rays per sector for scattered points, so that no sector between filled ones is empty."""
STEEPEST, FLATTEST, BINS = np.float32(-1.0), np.float32(0.25), 40
"""Bins of slope, rise per metre: 1.8 degrees each, finer than the spacing of beams."""
# How far the lidar lies from the middle of the window: its mount, half a cell, and what it moves while it sweeps.
_LIDAR_OFF_M = 1.0
# A ray stops this far before its end, in cells: the cell in which it ends, or that it only touches, is not crossed.
_SHORT_CELLS = 0.75
_GROUND, _OBSTACLE = np.uint8(PointClass.GROUND), np.uint8(PointClass.OBSTACLE)
_INF, _NONE, _MM = np.float32(np.inf), np.float32(0), np.float32(1000)
# So that heights stay within 16 bits.
_HIGHEST_MM = np.float32(32000)


@dataclass(frozen=True, slots=True)
class PlacingSettings:
    """Which returns block a cell.

    min_height_m, max_height_m: above the ground; lower and higher points do not block. body_length_m, body_width_m,
    body_margin_m: points in this box about base's origin are the robot. highest_m: how high above the ground rays
    still matter. min_points: a cell with fewer obstacle points is not hit. target_radius_m: points nearer to the
    target than this are the target.
    """

    min_height_m: float = 0.05
    max_height_m: float = 1.5
    body_length_m: float = 0.62
    body_width_m: float = 0.26
    body_margin_m: float = 0.1
    highest_m: float = 1.6
    min_points: int = 1
    target_radius_m: float = 0.5


class PlacedScan(NamedTuple):
    """Cells (rows, cols) int16, in mm above the ground.

    top_mm: the highest obstacle point, NO_TOP where there is none. lowest_ray_mm: how low the cell was seen through,
    NO_RAY where no ray crossed it.
    """

    top_mm: NDArray[np.int16]
    lowest_ray_mm: NDArray[np.int16]


def reach_of(scan: ClassifiedScan, window: Window) -> float:
    """How far from the lidar the corners of a window about the robot lie at most, in metres."""
    return window.cell_m * math.hypot(*window.shape) / 2 + _LIDAR_OFF_M + math.hypot(*scan.lidar_base_m[:2])


def slot_transforms(scan: ClassifiedScan, poses: Float, origin_m: Float) -> Float:
    """(K, 4) cosine and sine of the yaw, and the lidar's x and y from origin_m (2,), at time slots; poses: (K, 3)."""
    (x_m, y_m, yaw_rad), (lidar_x, lidar_y) = poses.T, scan.lidar_base_m[:2]
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    start_m = x_m - origin_m[0] + cos * lidar_x - sin * lidar_y, y_m - origin_m[1] + sin * lidar_x + cos * lidar_y
    return np.column_stack([cos, sin, *start_m])


@inner
def place_at(returns: Returns, i: int, transforms: Float) -> tuple[float, float]:
    """Return i in map, x and y, from the origin of `slot_transforms`."""
    at, x, y = transforms[returns.slot[i]], returns.dx_m[i], returns.dy_m[i]
    return at[2] + at[0] * x - at[1] * y, at[3] + at[1] * x + at[0] * y


def place_scan(
    scan: ClassifiedScan, slot_pose_base_in_map: Float, window: Window, target_xy_m: Float, settings: PlacingSettings
) -> PlacedScan:
    """Tops and lowest rays of a scan in a window; slot_pose_base_in_map: (K, 3) x, y, yaw at its time slots.

    target_xy_m: (2,) in map, NaN when nothing is followed. In a scan without ground, as a 2-D scanner's, one point is
    enough for a cell to be hit: a wall has no more. Rays end on the ground or on an obstacle, but not on the robot.
    Those of one sector and one slope count as one, the shortest and flattest: a cell is crossed where all agree.
    """
    placed, found = PlacedScan(*np.empty((2, *window.shape), np.int16)), scan.returns
    transforms = slot_transforms(scan, slot_pose_base_in_map, window.origin_m)
    half_body_m = np.array([settings.body_length_m, settings.body_width_m]) / 2 + settings.body_margin_m
    n_ground, n_obstacle = scan.counts[[PointClass.GROUND, PointClass.OBSTACLE]].tolist()
    limits = np.array([*scan.lidar_base_m[:2], *half_body_m, settings.min_height_m, settings.max_height_m], np.float32)
    target = np.array([*(target_xy_m - window.origin_m), settings.target_radius_m**2], np.float32)
    fewest = settings.min_points if n_ground else 1
    place_m = _raise_tops(found, transforms, limits, target, window.cell_m, fewest, placed.top_mm)
    if scan.route in ("rings", "elevations"):
        # One and a half columns in each sector at least: wherever they lie, none is empty.
        sectors = min(max(scan.columns * 2 // 3, 1), MOST_SECTORS)
    else:
        sectors = min(max((n_ground + n_obstacle) // RAYS_IN_SECTOR, FEWEST_SECTORS), MOST_SECTORS)
    start_m, most_m = (*transforms[:, 2:].sum(axis=0) / len(transforms), scan.lidar_base_m[2]), reach_of(scan, window)
    rays = np.array([*start_m, most_m, settings.highest_m, window.cell_m], np.float32)
    profile_mm = np.empty((sectors, int(2 * most_m / window.cell_m) + 2), np.int16)
    _lower_rays(found, place_m, limits, rays, profile_mm, placed)
    return placed


@inner
def _on_robot(dx_m: np.float32, dy_m: np.float32, limits: Float32) -> bool:
    return (abs(dx_m + limits[0]) <= limits[2]) & (abs(dy_m + limits[1]) <= limits[3])


@kernel
def _raise_tops(
    returns: Returns, transforms: Float, limits: Float32, target: Float32, cell_m: float, min_points: int,
    top_mm: NDArray[np.int16],
) -> Float32:  # fmt: skip
    """Returns the places (2, N) of all points in the window. transforms: of `slot_transforms`.

    limits: the lidar's x and y in base, half of the body, and the heights that block. target: place and squared radius.
    """
    dx_m, dy_m, height_m, label = returns.dx_m, returns.dy_m, returns.height_m, returns.label
    (rows, cols), per_cell = top_mm.shape, np.float32(1.0 / cell_m)
    count, place_m = np.zeros((rows, cols), np.int32), np.empty((2, len(label)), np.float32)
    top_mm[:] = NO_TOP
    for i in range(len(label)):
        place_m[0, i], place_m[1, i] = place_at(returns, i, transforms)
    for i in range(len(label)):
        above = height_m[i]
        if label[i] != _OBSTACLE or not limits[4] <= above <= limits[5] or _on_robot(dx_m[i], dy_m[i], limits):
            continue
        dx, dy = place_m[0, i] - target[0], place_m[1, i] - target[1]
        col, row = place_m[0, i] * per_cell, place_m[1, i] * per_cell
        # Compared as floats: a huge or NaN coordinate must not reach the cast to an index.
        inside = col >= _NONE and col < cols and row >= _NONE and row < rows
        if inside and not dx * dx + dy * dy <= target[2]:
            at = np.int64(row), np.int64(col)
            top_mm[at] = max(top_mm[at], np.int16(min(above * _MM, _HIGHEST_MM)))
            count[at] += 1
    for r in range(rows):
        for c in range(cols):
            if count[r, c] < min_points:
                top_mm[r, c] = NO_TOP
    return place_m


@kernel
def _lower_rays(
    returns: Returns, place_m: Float32, limits: Float32, rays: Float32, profile_mm: NDArray[np.int16],
    placed: PlacedScan,
) -> None:  # fmt: skip
    """rays: x, y and height of their start, the greatest reach and height that matter, and the edge of a cell.

    profile_mm: (sectors, steps) room for the height of the lowest ray of each sector every half a cell outwards.
    """
    dx_m, dy_m, height_m, label = returns.dx_m, returns.dy_m, returns.height_m, returns.label
    start_x, start_y, start_z, most_m, highest_m, cell_m = rays[0], rays[1], rays[2], rays[3], rays[4], rays[5]
    (sectors, steps), n, per_bin = profile_mm.shape, len(label), np.float32(BINS) / (FLATTEST - STEEPEST)
    per_turn, last, nowhere = np.float32(sectors), np.int32(sectors - 1), np.int32(sectors * BINS)
    length_m, rise, at = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.int32)
    # Without branches, so that it becomes vector instructions. What counts for nothing has one bin more than there are.
    for i in range(n):
        x, y = place_m[0, i] - start_x, place_m[1, i] - start_y
        length = np.sqrt(x * x + y * y)
        climb = (height_m[i] - start_z) / length
        ends = ((label[i] == _GROUND) | (label[i] == _OBSTACLE)) & (not _on_robot(dx_m[i], dy_m[i], limits))
        # NaN and infinity fail these comparisons as well.
        counts = ends & (length > np.float32(1e-3)) & (length < np.float32(1e6)) & (climb < FLATTEST)
        k, sector = (climb - STEEPEST) * per_bin, np.int32(turn_of(x, y) * per_turn)
        k, sector = k if counts & (k > _NONE) else _NONE, sector if sector < last else last
        length_m[i], rise[i] = length if counts else _INF, climb if counts else -_INF
        at[i] = sector * np.int32(BINS) + np.int32(k) if counts else nowhere
    reach_m, slope = np.full((sectors + 1) * BINS, _INF), np.full((sectors + 1) * BINS, -_INF)
    for i in range(n):
        k = np.uint32(at[i])
        reach_m[k], slope[k] = min(reach_m[k], length_m[i]), max(slope[k], rise[i])
    step_m, highest = np.float32(0.5) * cell_m, np.float32(NO_RAY)
    for s in range(sectors):
        heights_mm = profile_mm[s]
        # Each ray that counts reaches farther and passes higher than the one before.
        farthest, done = _NONE, 0
        for k in range(s * BINS, (s + 1) * BINS):
            if reach_m[k] == _INF or reach_m[k] <= farthest:
                continue
            if farthest > most_m or start_z + slope[k] * farthest > highest_m:
                break
            farthest = reach_m[k]
            until = max(min(np.int64((farthest - np.float32(_SHORT_CELLS) * cell_m) / step_m), steps - 1), done)
            first_mm, rise_mm = _MM * start_z, _MM * slope[k] * step_m
            for step in range(done, until):
                height_mm = first_mm + rise_mm * (np.float32(np.int32(step)) + np.float32(0.5))
                heights_mm[step] = np.int16(np.int32(max(min(height_mm, highest), -highest)))
            done = until
        heights_mm[done:] = NO_RAY
    _look_up(start_x / cell_m, start_y / cell_m, profile_mm, placed.lowest_ray_mm)


@inner
def _look_up(start_col: float, start_row: float, profile_mm: NDArray[np.int16], lowest_mm: NDArray[np.int16]) -> None:
    """The height of each cell's sector at its distance from the start, both of the cell's middle."""
    (rows, cols), (sectors, steps), half = lowest_mm.shape, profile_mm.shape, np.float32(0.5)
    dx, step, sector = np.empty(cols, np.float32), np.empty(cols, np.int32), np.empty(cols, np.int32)
    last_step, last, flat = np.float32(steps - 1), np.float32(sectors - 1), profile_mm.reshape(-1)
    for col in range(cols):
        dx[col] = np.float32(col) + half - start_col
    for row in range(rows):
        dy, lowest = np.float32(row) + half - start_row, lowest_mm[row]
        for col in range(cols):
            away = np.sqrt(dx[col] * dx[col] + dy * dy) * np.float32(2)
            step[col] = np.int32(away if away < last_step else last_step)
        for col in range(cols):
            at = turn_of(dx[col], dy) * np.float32(sectors)
            sector[col] = np.int32(at if at < last else last)
        for col in range(cols):
            lowest[col] = flat[np.uint32(sector[col] * steps + step[col])]
