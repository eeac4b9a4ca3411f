"""Ray tracing: free space between the lidar and its returns, down to the height of the lowest ray.

The rays of a scan are gathered by direction: of each sector the few that count, by reach and slope. Every cell of the
window takes its height from the sector it lies in, so that none in sight is left out, however far off it is.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inner, kernel
from quadlog.lidar.classified_scan import ClassifiedScan, PointClass, Returns
from quadlog.lidar.range_image import turn_of
from quadlog.mapping.grid import Window
from quadlog.messages import Float, Float32

MOST_SECTORS, FEWEST_SECTORS = 512, 64
"""Number of directions; at the edge of a 20 m window they are about as far apart as a cell of 0.1 m is wide."""
RAYS_IN_SECTOR = 16
"""Rays per sector for scattered points, so that no sector between filled ones is empty."""
STEEPEST, FLATTEST, BINS = -1.0, 0.25, 40
"""Bins of slope, rise per metre: 1.8 degrees each, finer than the spacing of beams."""
NO_RAY = np.int16(32767)
"""Height, in mm, of the lowest ray through a cell that none crossed."""
_DIRECTIONS = 4096
# A ray stops this far before its end, in cells: the cell in which it ends, or that it only touches, is not crossed.
_SHORT_CELLS = 0.75
_GROUND, _OBSTACLE = np.uint8(PointClass.GROUND), np.uint8(PointClass.OBSTACLE)
_INF, _NONE = np.float32(np.inf), np.float32(0)


def lowest_rays(
    scan: ClassifiedScan,
    half_body_m: Float,
    highest_m: float,
    slot_pose_base_in_map: Float,
    window: Window,
    reach_m: float,
    lowest_mm: NDArray[np.int16],
) -> None:
    """Fill lowest_mm (rows, cols) with the height above the ground of the lowest ray through each cell, or NO_RAY.

    Rays end on the ground or on an obstacle, but not on the robot: half_body_m (2,) is half of the box about base's
    origin. Rays of one sector and one slope count as one, the shortest and flattest of them, so that a cell is called
    crossed only where all agree. highest_m, reach_m: what lies higher above the ground or farther from the lidar does
    not matter. slot_pose_base_in_map: (K, 3) x, y, yaw at the scan's time slots. The rays start where the lidar was on
    average; what it moved while the scan lasted moves their ends.
    """
    if scan.route in ("rings", "elevations"):
        # One and a half columns in each sector at least: wherever they lie, none is empty.
        sectors = min(max(scan.columns * 2 // 3, 1), MOST_SECTORS)
    else:
        n_ended = scan.count(PointClass.GROUND) + scan.count(PointClass.OBSTACLE)
        sectors = min(max(n_ended // RAYS_IN_SECTOR, FEWEST_SECTORS), MOST_SECTORS)
    limits = np.array([*scan.lidar_base_m, *half_body_m, reach_m, highest_m], np.float32)
    where = np.array([*scan.lidar_base_m, window.col0, window.row0, window.cell_m, reach_m], np.float64)
    width = scan.columns or max(len(scan.returns.label), 1)
    _trace(scan.returns, width, limits, slot_pose_base_in_map, where, _outward(sectors), lowest_mm)


@inner
def _gather(
    returns: Returns, width: int, limits: Float32, reach_m: Float32, slope: Float32, sector_slot: NDArray[np.int32]
) -> None:
    """Fill reach_m and slope (sectors * BINS + 1,) with the rays, whose reach is infinite where there is none, and
    sector_slot with the time slot of each sector, -1 without rays.

    width: points that are looked at together. limits: the lidar's x, y and height, half of the body, and the greatest
    reach and height. Of a sector each ray reaches farther and passes higher than the one before.
    """
    dx_m, dy_m, height_m, label, slot = returns.dx_m, returns.dy_m, returns.height_m, returns.label, returns.slot
    n, sectors = len(label), len(sector_slot)
    length_m, rise, place = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.int32)
    bin_slot = np.empty(len(reach_m), np.uint8)
    for bin_k in range(sectors * BINS + 1):
        reach_m[bin_k], slope[bin_k] = _INF, -_INF
    for begin in range(0, n, width):
        size = min(width, n - begin)
        slots = slot[begin:]
        _bins(size, dx_m[begin:], dy_m[begin:], height_m[begin:], label[begin:], limits, sectors, length_m, rise, place)
        for c in range(size):
            k = np.uint32(place[c])
            # Written unconditionally: a mispredicted branch takes longer.
            reach_m[k] = min(length_m[c], reach_m[k])
            slope[k] = max(rise[c], slope[k])
            bin_slot[k] = slots[c]
    lidar_m, most_m, highest_m = limits[2], limits[5], limits[6]
    for s in range(sectors):
        farthest, matters = _NONE, True
        sector_slot[s] = -1
        for place_k in range(s * BINS, (s + 1) * BINS):
            k = np.uint32(place_k)
            if reach_m[k] == _INF:
                continue
            longer = reach_m[k] > farthest
            matters &= not longer or (farthest <= most_m and lidar_m + slope[k] * farthest <= highest_m)
            if longer and matters:
                farthest, sector_slot[s] = reach_m[k], bin_slot[k]
            else:
                reach_m[k] = _INF


@inner
def _bins(
    size: int, dx_m: Float32, dy_m: Float32, height_m: Float32, label: NDArray[np.uint8], limits: Float32,
    sectors: int, length_m: Float32, rise: Float32, place: NDArray[np.int32],
) -> None:  # fmt: skip
    """Horizontal length and slope of each ray, and sector * BINS + bin.

    Of rays that count for nothing the length is infinite, the slope -infinity and the bin one more than there are.
    """
    per_bin, steepest, flattest = np.float32(BINS / (FLATTEST - STEEPEST)), np.float32(STEEPEST), np.float32(FLATTEST)
    per_turn, last, nowhere = np.float32(sectors), np.int32(sectors - 1), np.int32(sectors * BINS)
    x0, y0, z0, half_length, half_width = limits[0], limits[1], limits[2], limits[3], limits[4]
    for c in range(size):
        dx, dy = dx_m[c], dy_m[c]
        length = np.sqrt(dx * dx + dy * dy)
        climb = (height_m[c] - z0) / length
        beside = (abs(dx + x0) > half_length) | (abs(dy + y0) > half_width)
        surface = (label[c] == _GROUND) | (label[c] == _OBSTACLE)
        # NaN and infinity fail these comparisons as well.
        counts = surface & beside & (length > np.float32(1e-3)) & (length < np.float32(1e6)) & (climb < flattest)
        k = (climb - steepest) * per_bin
        k = k if k > _NONE else _NONE
        k = k if counts else _NONE
        sector = np.int32(turn_of(dx, dy) * per_turn)
        sector = sector if sector < last else last
        length_m[c], rise[c] = length if counts else _INF, climb if counts else -_INF
        place[c] = sector * np.int32(BINS) + np.int32(k) if counts else nowhere


@lru_cache(maxsize=8)
def _outward(sectors: int) -> Float:
    """(2, sectors) directions of sectors in base."""
    middle_rad = (np.arange(sectors) + 0.5) * (2 * np.pi / sectors)
    return np.stack([np.cos(middle_rad), np.sin(middle_rad)])


@kernel
def _trace(
    returns: Returns, width: int, limits: Float32, poses: Float, where: Float, outward: Float,
    lowest_mm: NDArray[np.int16],
) -> None:  # fmt: skip
    """where: the lidar's x, y and height, the window's first column and row on the lattice, the edge of a cell, and
    the reach. outward: (2, sectors) directions of the sectors in base.
    """
    sectors, n, cell_m = outward.shape[1], len(poses), where[5]
    reach_m, slope = np.empty(sectors * BINS + 1, np.float32), np.empty(sectors * BINS + 1, np.float32)
    sector_slot, sector, moved_m = np.empty(sectors, np.int32), np.empty(_DIRECTIONS, np.int32), np.empty((5, n))
    profile_mm = np.empty((sectors + 1, int(2 * where[6] / cell_m) + 2), np.int16)
    _gather(returns, width, limits, reach_m, slope, sector_slot)
    start_x_m, start_y_m = 0.0, 0.0
    for k in range(n):
        cos, sin = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        moved_m[0, k] = poses[k, 0] + cos * where[0] - sin * where[1]
        moved_m[1, k] = poses[k, 1] + sin * where[0] + cos * where[1]
        moved_m[2, k] = poses[k, 2] / (2.0 * math.pi)
        moved_m[3, k], moved_m[4, k] = cos, sin
        start_x_m += moved_m[0, k]
        start_y_m += moved_m[1, k]
    start_x_m, start_y_m = start_x_m / n, start_y_m / n
    for k in range(n):
        moved_m[0, k] -= start_x_m
        moved_m[1, k] -= start_y_m
    _draw_profiles(sector_slot, reach_m, slope, where[2], moved_m, outward, cell_m, sector, profile_mm)
    col, row = start_x_m / cell_m - where[3], start_y_m / cell_m - where[4]
    _look_up(np.float32(col), np.float32(row), sector, profile_mm, lowest_mm)


@inner
def _draw_profiles(
    sector_slot: NDArray[np.int32], reach_m: Float32, slope: Float32, lidar_m: float, moved: Float, outward: Float,
    cell_m: float, sector: NDArray[np.int32], profile_mm: NDArray[np.int16],
) -> None:  # fmt: skip
    """Fill sector (_DIRECTIONS,), which one looks along each direction of map, and profile_mm (sectors + 1, steps),
    the height of the lowest ray of each every half a cell outwards; the last one is for directions without a sector.

    moved: (5, K) x, y in metres by which the lidar was elsewhere at each time slot, its yaw in turns, and the cosine
    and sine of that.
    """
    n, steps, step_m = len(sector_slot), profile_mm.shape[1], 0.5 * cell_m
    sector[:], profile_mm[n, :] = n, NO_RAY
    for s in range(n):
        at = sector_slot[s]
        if at < 0:
            continue
        after = sector_slot[s + 1 if s + 1 < n else 0]
        first = moved[2, at] + s / n
        # The next sector was perhaps measured later, when the robot had turned; a wide gap is the scan's seam.
        wide = moved[2, after if after >= 0 else at] - moved[2, at] + 1.0 / n
        wide -= math.floor(wide)
        wide = wide if wide < 2.0 / n else 1.0 / n
        begin, end = math.ceil(first * _DIRECTIONS - 0.5), math.ceil((first + wide) * _DIRECTIONS - 0.5)
        for d in range(np.int64(begin), np.int64(end)):
            sector[d & (_DIRECTIONS - 1)] = s
        x = moved[3, at] * outward[0, s] - moved[4, at] * outward[1, s]
        y = moved[4, at] * outward[0, s] + moved[3, at] * outward[1, s]
        shift_m = x * moved[0, at] + y * moved[1, at]
        done, heights = np.int64(0), profile_mm[s]
        for k in range(s * BINS, (s + 1) * BINS):
            if reach_m[k] == _INF:
                continue
            until_m = reach_m[k] + shift_m - _SHORT_CELLS * cell_m
            until = min(max(np.int64(math.floor(until_m / step_m)), done), steps - 1)
            climb = np.float64(slope[k])
            first_mm = np.float32(1000.0 * (lidar_m + climb * (0.5 * step_m - shift_m)))
            _draw_line(heights, done, until, first_mm, np.float32(1000.0 * climb * step_m))
            done = until
        _draw_line(heights, done, steps, np.float32(NO_RAY), _NONE)


@inner
def _draw_line(heights_mm: NDArray[np.int16], begin: int, end: int, first_mm: float, step_mm: float) -> None:
    for k in range(np.uint32(begin), np.uint32(end)):
        height = first_mm + np.float32(k) * step_mm
        height = min(height, np.float32(NO_RAY))
        heights_mm[k] = np.int16(max(height, np.float32(-NO_RAY)))


@inner
def _look_up(
    start_col: float, start_row: float, sector: NDArray[np.int32], profile_mm: NDArray[np.int16],
    lowest_mm: NDArray[np.int16],
) -> None:  # fmt: skip
    """The height of each cell's sector at its distance from the start, both of the cell's middle."""
    rows, cols = lowest_mm.shape
    dx, step, direction = np.empty(cols, np.float32), np.empty(cols, np.int32), np.empty(cols, np.int32)
    last, steps = np.float32(profile_mm.shape[1] - 1), profile_mm.shape[1]
    flat = profile_mm.reshape(-1)
    for col in range(cols):
        dx[col] = np.float32(col) + np.float32(0.5) - start_col
    for row in range(rows):
        dy = np.float32(row) + np.float32(0.5) - start_row
        squared, lowest = dy * dy, lowest_mm[row]
        for col in range(cols):
            away = np.sqrt(dx[col] * dx[col] + squared) * np.float32(2)
            step[col] = np.int32(away if away < last else last)
        for col in range(cols):
            at = np.int32(turn_of(dx[col], dy) * np.float32(_DIRECTIONS))
            direction[col] = at if at < np.int32(_DIRECTIONS) else np.int32(_DIRECTIONS - 1)
        for col in range(cols):
            lowest[col] = flat[np.uint32(sector[np.uint32(direction[col])] * steps + step[col])]
