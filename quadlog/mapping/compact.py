"""Compact scans: the part of a classified scan that maps need, in some tens of kilobytes.

Everything lies in base, levelled by the tilt at the time of the scan, and is not deskewed: each item carries the time
slot in which it was measured, so that one rigid transform per slot puts it where it was.
Once the poses are known, it is laid on the grid around the robot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inner, kernel
from quadlog.lidar.classified_scan import ClassifiedScan, PointClass
from quadlog.lidar.range_image import Returns
from quadlog.mapping.grid import Window
from quadlog.mapping.ray_tracing import Rays, gather_rays, lowest_rays
from quadlog.messages import Float, Float32

UInt8 = NDArray[np.uint8]
OBSTACLE = np.dtype([("x", "i2"), ("y", "i2"), ("height_mm", "i2"), ("count", "u1"), ("slot", "u1")])
GROUND = np.dtype([("x", "i2"), ("y", "i2"), ("z_mm", "i2"), ("count", "u2"), ("slot", "u1")], align=True)

THIN_M = 0.025
"""Edge of the cells of base in which obstacle points count as one: a quarter of a map's usual cell."""
MOST_COUNT = 255
# Points of one cell that were measured farther apart than this lie in different places of map.
_SAME_TIME_SLOTS = 2
_UNITS = 32000
# How far the lidar lies from the middle of the window: its mount, half a cell, and what it moves while it sweeps.
_LIDAR_OFF_M = 1.0
_GROUND, _OBSTACLE = np.uint8(PointClass.GROUND), np.uint8(PointClass.OBSTACLE)


def reach_of(cell_m: float, size_cells: int) -> float:
    """How far from the lidar the corners of a square window about the robot lie at most, in metres."""
    return cell_m * size_cells * math.sqrt(0.5) + _LIDAR_OFF_M


@dataclass(frozen=True, slots=True)
class CompactSettings:
    """Parameters of compact scans.

    min_height_m, max_height_m: above the ground; lower and higher points do not block. body_length_m, body_width_m,
    body_margin_m: points in this box about base's origin are the robot. reach_m: what lies farther from the lidar is in
    no window. highest_m: how high above the ground rays still matter. ground_cell_m: edge of the cells over which
    ground returns are averaged. counts: whether it matters how many points hit a cell.
    """

    min_height_m: float = 0.05
    max_height_m: float = 1.5
    body_length_m: float = 0.62
    body_width_m: float = 0.26
    body_margin_m: float = 0.1
    reach_m: float = 15.2
    highest_m: float = 1.6
    ground_cell_m: float = 0.2
    counts: bool = False


@dataclass(frozen=True, slots=True)
class CompactScan:
    """One scan, ready to be placed in map; x and y are in units of unit_m, rounded down.

    lidar_base_m: (3,) x, y in base and height above the ground. obstacle: (N,) of OBSTACLE, the height above the ground
    of the highest of `count` points that were next to each other. ground: (G,) of GROUND, means of `count` points of a
    cell.
    """

    unit_m: float
    reach_m: float
    lidar_base_m: Float
    obstacle: NDArray[np.void]
    rays: Rays
    ground: NDArray[np.void]


def compact_scan(scan: ClassifiedScan, settings: CompactSettings) -> CompactScan:
    """The compact form of a scan."""
    n, reach_m = len(scan.returns.label), settings.reach_m
    half_body_m = np.array([settings.body_length_m, settings.body_width_m]) / 2 + settings.body_margin_m
    unit_m = max(2 * reach_m / _UNITS, 1e-3)
    # Cells are counted by 15 bits along each axis.
    thin_m, ground_m = (max(cell_m, 2.2 * reach_m / _UNITS) for cell_m in (THIN_M, settings.ground_cell_m))
    heights_m = settings.min_height_m, settings.max_height_m
    limits = np.array(
        [*scan.lidar_base_m, *half_body_m, *heights_m, reach_m, 1 / thin_m, 1 / ground_m, 1 / unit_m], np.float32
    )
    obstacle, ground = np.empty(n, OBSTACLE), np.empty(n, GROUND)
    n_obstacles = _keep_obstacles(scan.returns, scan.columns or max(n, 1), limits, settings.counts, obstacle)
    n_ground = _average_ground(scan.returns, limits, ground)
    rays = gather_rays(scan, half_body_m, unit_m, reach_m, settings.highest_m)
    kept = obstacle[:n_obstacles].copy(), rays, ground[:n_ground].copy()
    return CompactScan(unit_m, reach_m, scan.lidar_base_m, *kept)


@inner
def slot_transforms(poses: Float, unit_m: float) -> Float:
    """(K, 4) cosine and sine of the yaw times unit_m, and x, y, of poses (K, 3) x, y, yaw at the time slots."""
    moved = np.empty((len(poses), 4))
    for k in range(len(poses)):
        moved[k, 0], moved[k, 1] = math.cos(poses[k, 2]) * unit_m, math.sin(poses[k, 2]) * unit_m
        moved[k, 2], moved[k, 3] = poses[k, 0], poses[k, 1]
    return moved


_X, _Y, _HALF_LENGTH, _HALF_WIDTH, _LOWEST, _HIGHEST, _REACH = 0, 1, 3, 4, 5, 6, 7
_PER_THIN, _PER_CELL, _PER_UNIT = 8, 9, 10
# So that sums of heights stay within 16 bits.
_HIGHEST_MM = np.float32(32000)
_NOWHERE, _MIDDLE, _ROW = np.int32(-1), np.float32(16384), np.int32(32768)


@kernel
def _keep_obstacles(returns: Returns, width: int, limits: Float32, counts: bool, obstacle: NDArray[np.void]) -> int:
    """One of the points that block in each cell of THIN_M, with the greatest height of them.

    Of neighbours in a row that lie in one cell only the first is looked at, unless it matters how many there are.
    The table holds which item was kept last of the cells that share a place in it; of two such cells that take turns
    some points are kept twice, which changes no map.
    """
    dx_m, dy_m, height_m, label, slot = returns.dx_m, returns.dy_m, returns.height_m, returns.label, returns.slot
    table, mask = np.empty((2, 1 << 13), np.int32), np.int32((1 << 13) - 1)
    key, column = np.empty(width, np.int32), np.empty(width + 1, np.int32)
    kept, n, x0, y0, per_unit = 0, len(label), limits[_X], limits[_Y], limits[_PER_UNIT]
    table[:] = _NOWHERE
    for begin in range(0, n, width):
        size = min(width, n - begin)
        dxs, dys, heights, slots = dx_m[begin:], dy_m[begin:], height_m[begin:], slot[begin:]
        _thin_cells(size, dxs, dys, heights, label[begin:], limits, key)
        n_columns, before = 0, _NOWHERE
        for c in range(size):
            # Written unconditionally: a mispredicted branch takes longer.
            column[n_columns] = c
            n_columns += (key[c] != _NOWHERE) & ((key[c] != before) | counts)
            before = key[c] if key[c] != _NOWHERE else before
        for j in range(n_columns):
            c = column[j]
            cell, millimetres = key[c], np.int16(min(heights[c] * np.float32(1000), _HIGHEST_MM))
            at = np.uint32((cell ^ (cell >> np.int32(15)) * np.int32(73)) & mask)
            if table[1, at] == cell:
                same = obstacle[np.uint32(table[0, at])]
                if abs(np.int64(same["slot"]) - slots[c]) <= _SAME_TIME_SLOTS:
                    same["height_mm"] = max(same["height_mm"], millimetres)
                    same["count"] += same["count"] < MOST_COUNT
                    continue
            table[0, at], table[1, at] = kept, cell
            item = obstacle[np.uint32(kept)]
            item["x"] = np.int16(np.floor((dxs[c] + x0) * per_unit))
            item["y"] = np.int16(np.floor((dys[c] + y0) * per_unit))
            item["height_mm"], item["count"], item["slot"] = millimetres, 1, slots[c]
            kept += 1
    return kept


@inner
def _thin_cells(
    size: int, dx_m: Float32, dy_m: Float32, height_m: Float32, label: UInt8, limits: Float32, key: NDArray[np.int32]
) -> None:
    """The cell of THIN_M of every point that blocks, _NOWHERE of all others."""
    x0, y0, half_length, half_width = limits[_X], limits[_Y], limits[_HALF_LENGTH], limits[_HALF_WIDTH]
    lowest, highest, per_thin = limits[_LOWEST], limits[_HIGHEST], limits[_PER_THIN]
    farthest = limits[_REACH] * limits[_REACH]
    for c in range(size):
        dx, dy, above = dx_m[c], dy_m[c], height_m[c]
        x, y = dx + x0, dy + y0
        beside = (abs(x) > half_length) | (abs(y) > half_width)
        high = (above >= lowest) & (above <= highest)
        blocks = (label[c] == _OBSTACLE) & high & beside & (dx * dx + dy * dy <= farthest)
        cell = np.int32(x * per_thin + _MIDDLE) * _ROW + np.int32(y * per_thin + _MIDDLE)
        key[c] = cell if blocks else _NOWHERE


@kernel
def _average_ground(returns: Returns, limits: Float32, ground: NDArray[np.void]) -> int:
    """Means of the ground points of every cell; table as for `_keep_obstacles`, sums: x, y, z and count of items."""
    dx_m, dy_m, z_m, label, slot = returns.dx_m, returns.dy_m, returns.z_m, returns.label, returns.slot
    table, mask = np.empty((2, 1 << 12), np.int32), np.int32((1 << 12) - 1)
    kept, n, sums = 0, len(label), np.empty((len(ground), 4), np.float32)
    x0, y0, per_cell = limits[_X], limits[_Y], limits[_PER_CELL]
    farthest = limits[_REACH] * limits[_REACH]
    table[:] = _NOWHERE
    before, item = _NOWHERE, 0
    for i in range(n):
        if label[i] != _GROUND:
            continue
        dx, dy = dx_m[i], dy_m[i]
        # NaN fails this comparison as well.
        if not dx * dx + dy * dy <= farthest:
            continue
        x, y = dx + x0, dy + y0
        cell = np.int32(x * per_cell + _MIDDLE) * _ROW + np.int32(y * per_cell + _MIDDLE)
        if cell != before:
            at = np.uint32((cell ^ (cell >> np.int32(15)) * np.int32(73)) & mask)
            item, before = int(table[0, at]), cell
            if table[1, at] != cell or sums[item, 3] >= np.float32(65535):
                item = kept
                table[0, at], table[1, at] = item, cell
                sums[item, 0], sums[item, 1], sums[item, 2], sums[item, 3] = 0, 0, 0, 0
                ground[item]["slot"] = slot[i]
                kept += 1
        sums[item, 0] += x
        sums[item, 1] += y
        sums[item, 2] += z_m[i]
        sums[item, 3] += np.float32(1)
    per_unit, most = limits[_PER_UNIT], np.float32(32767)
    for item in range(kept):
        share, mean = np.float32(1) / sums[item, 3], ground[item]
        mean["x"] = np.int16(np.floor(sums[item, 0] * share * per_unit))
        mean["y"] = np.int16(np.floor(sums[item, 1] * share * per_unit))
        mean["z_mm"] = np.int16(np.rint(min(max(sums[item, 2] * share * np.float32(1000), -most), most)))
        mean["count"] = np.uint16(sums[item, 3])
    return kept


NO_TOP = np.int16(-32768)
"""Height, in mm, of the highest obstacle point in a cell in which nothing was hit."""


class PlacedScan(NamedTuple):
    """Cells (rows, cols) int16, in mm above the ground.

    top_mm: the highest obstacle point, NO_TOP where there is none. lowest_ray_mm: how low the cell was seen through,
    NO_RAY where no ray crossed it.
    """

    top_mm: NDArray[np.int16]
    lowest_ray_mm: NDArray[np.int16]


def place_scan(
    scan: CompactScan,
    slot_pose_base_in_map: Float,
    window: Window,
    target_xy_m: Float,
    min_points: int,
    target_radius_m: float,
) -> PlacedScan:
    """Tops and lowest rays of a scan in a window; slot_pose_base_in_map: (K, 3) x, y, yaw at its time slots.

    target_xy_m: (2,) in map, NaN when nothing is followed; points nearer to it than target_radius_m are the target.
    min_points: a cell with fewer obstacle points is not hit; in a scan without ground, as a 2-D scanner's, one is
    enough: a wall has no more.
    """
    placed = PlacedScan(*np.empty((2, *window.shape), np.int16))
    # A place that is not a number is near to nothing.
    place = np.array([window.col0, window.row0, window.cell_m, *target_xy_m, target_radius_m**2], np.float64)
    fewest = min_points if len(scan.ground) else 1
    _raise_tops(scan.obstacle, slot_pose_base_in_map, scan.unit_m, place, fewest, placed.top_mm)
    where = scan.lidar_base_m, slot_pose_base_in_map, window, scan.reach_m
    lowest_rays(scan.rays, scan.unit_m, *where, placed.lowest_ray_mm)
    return placed


@kernel
def _raise_tops(
    obstacle: NDArray[np.void], poses: Float, unit_m: float, place: Float, min_points: int, top_mm: NDArray[np.int16]
) -> None:
    """place: the window's first column and row on the lattice, the edge of a cell, and the target's place and squared
    radius.
    """
    rows, cols = top_mm.shape
    top_mm[:] = NO_TOP
    counts = min_points > 1
    count = np.zeros((rows, cols) if counts else (0, 0), np.int32)
    moved = slot_transforms(poses, unit_m)
    per_cell, col0, row0 = 1.0 / place[2], place[0], place[1]
    for i in range(len(obstacle)):
        at, x, y = obstacle[i]["slot"], obstacle[i]["x"] + 0.5, obstacle[i]["y"] + 0.5
        map_x_m = moved[at, 2] + moved[at, 0] * x - moved[at, 1] * y
        map_y_m = moved[at, 3] + moved[at, 1] * x + moved[at, 0] * y
        dx, dy = map_x_m - place[3], map_y_m - place[4]
        col, row = math.floor(map_x_m * per_cell) - col0, math.floor(map_y_m * per_cell) - row0
        # Compared as floats: a huge or NaN coordinate must not reach the cast to an index.
        inside = col >= 0.0 and col < cols and row >= 0.0 and row < rows
        if inside and not dx * dx + dy * dy <= place[5]:
            at_row, at_col = np.uint32(row), np.uint32(col)
            top_mm[at_row, at_col] = max(top_mm[at_row, at_col], obstacle[i]["height_mm"])
            if counts:
                count[at_row, at_col] += obstacle[i]["count"]
    if counts:
        for r in range(rows):
            for c in range(cols):
                if count[r, c] < min_points:
                    top_mm[r, c] = NO_TOP
