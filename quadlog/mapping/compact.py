"""Compact scans: the part of a classified scan that maps need, in some tens of kilobytes.

Everything lies in base, levelled by the tilt at the time of the scan, and is not deskewed: each item carries the time
slot in which it was measured, so that one rigid transform per slot puts it where it was.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from quadlog.compiled import inner, kernel
from quadlog.lidar.classified_scan import ClassifiedReturns, PointClass
from quadlog.lidar.ransac_plane import is_level
from quadlog.mapping.ray_tracing import RayGatherer, Rays
from quadlog.messages import Float, Float32, Int

Int16 = NDArray[np.int16]
UInt16 = NDArray[np.uint16]
UInt8 = NDArray[np.uint8]

THIN_M = 0.025
"""Edge of the cells of base in which obstacle points count as one: a quarter of a map's usual cell."""
MOST_COUNT = 255
# Points of one cell that were measured farther apart than this lie in different places of map.
_SAME_TIME_SLOTS = 2
_UNITS = 32000
# How far the lidar lies from the middle of the window: its mount, half a cell, and what it moves while it sweeps.
_LIDAR_OFF_M = 1.0
_HEADER = struct.Struct("<qd4d??BxHIII6x")
_GROUND, _OBSTACLE = np.uint8(PointClass.GROUND), np.uint8(PointClass.OBSTACLE)


def reach_of(cell_m: float, size_cells: int) -> float:
    """How far from the lidar the corners of a square window about the robot lie at most, in metres."""
    return cell_m * size_cells * math.sqrt(0.5) + _LIDAR_OFF_M


@dataclass(frozen=True, slots=True)
class ObstacleSettings:
    """Which points of a classified scan block the robot.

    min_height_m, max_height_m: above the ground; lower and higher points do not block.
    body_length_m, body_width_m, body_margin_m: points in this box about base's origin are the robot.
    """

    min_height_m: float = 0.05
    max_height_m: float = 1.5
    body_length_m: float = 0.62
    body_width_m: float = 0.26
    body_margin_m: float = 0.1


@dataclass(frozen=True, slots=True)
class CompactSettings:
    """Parameters of compact scans.

    blocking: what counts as an obstacle. reach_m: what lies farther from the lidar is in no window. highest_m: how
    high above the ground rays still matter. ground_cell_m: edge of the cells over which ground returns are averaged.
    counts: whether it matters how many points hit a cell.
    """

    blocking: ObstacleSettings
    reach_m: float = 15.2
    highest_m: float = 1.6
    ground_cell_m: float = 0.2
    counts: bool = False


@dataclass(frozen=True, slots=True)
class CompactScan:
    """One scan, ready to be placed in map; x and y are in units of unit_m, rounded down, and heights in mm.

    slot_ns: (K,) absolute instants of the middles of the time slots. lidar_base_m: (3,) x, y in base and height above
    the ground. obstacle: (N, 3) x, y and height above the ground of the highest of obstacle_count (N,) points that were
    next to each other. ground: (G, 3) x, y and z, the mean of ground_count (G,) points of a cell.
    level: whether the ground may be added to the run's ground. shows_nothing: whether maps must not use the scan.
    """

    t_ns: int
    slot_ns: Int
    unit_m: float
    reach_m: float
    lidar_base_m: Float
    level: bool
    shows_nothing: bool
    obstacle: Int16
    obstacle_count: UInt8
    obstacle_slot: UInt8
    rays: Rays
    ground: Int16
    ground_count: UInt16
    ground_slot: UInt8

    def to_bytes(self) -> bytes:
        """A fixed header and the arrays, one after the other; `from_bytes` reads it."""
        rays = self.rays
        flags = self.level, self.shows_nothing, len(self.slot_ns), len(rays.count)
        sizes = len(self.obstacle), len(rays.reach), len(self.ground)
        header = _HEADER.pack(self.t_ns, self.unit_m, self.reach_m, *self.lidar_base_m, *flags, *sizes)
        # Wide numbers first, so that views of them are aligned.
        arrays = (
            self.slot_ns, self.obstacle, rays.reach, rays.slope, self.ground, self.ground_count, self.obstacle_count,
            self.obstacle_slot, rays.count, rays.slot, self.ground_slot,
        )  # fmt: skip
        return b"".join([header, *(np.ascontiguousarray(each).data for each in arrays)])

    @classmethod
    def from_bytes(cls, data: bytes | memoryview) -> Self:
        """The scan that `to_bytes` wrote. Its arrays are views of data."""
        t_ns, unit_m, reach_m, *place_m, level, nothing, slots, sectors, n, n_rays, g = _HEADER.unpack_from(data)
        at = _HEADER.size

        def take(dtype: type, *shape: int) -> NDArray:
            nonlocal at
            array: NDArray = np.frombuffer(data, dtype, math.prod(shape), at).reshape(shape)
            at += array.nbytes
            return array if array.flags.aligned else _fixed(array.copy())

        slot_ns, obstacle = take(np.int64, slots), take(np.int16, n, 3)
        reach, slope = take(np.uint16, n_rays), take(np.int16, n_rays)
        ground, ground_count = take(np.int16, g, 3), take(np.uint16, g)
        obstacle_count, obstacle_slot = take(np.uint8, n), take(np.uint8, n)
        rays = Rays(take(np.uint8, sectors), take(np.uint8, sectors), reach, slope)
        head = t_ns, slot_ns, unit_m, reach_m, np.array(place_m), level, nothing
        return cls(*head, obstacle, obstacle_count, obstacle_slot, rays, ground, ground_count, take(np.uint8, g))


def _fixed(array: NDArray) -> NDArray:
    """The array, read-only, so that kernels are compiled for one kind of array."""
    array.flags.writeable = False
    return array


class ScanCompactor:
    """Makes compact scans, one after the other, in arrays that are kept from scan to scan."""

    def __init__(self, settings: CompactSettings) -> None:
        self._settings, self._gatherer = settings, RayGatherer()
        blocking = settings.blocking
        half_m = np.array([blocking.body_length_m, blocking.body_width_m]) / 2 + blocking.body_margin_m
        self._half_body_m = half_m
        self._unit_m = max(2 * settings.reach_m / _UNITS, 1e-3)
        # Cells are counted by 15 bits along each axis.
        self._least_cell_m = 2.2 * settings.reach_m / _UNITS
        self._thin_table: NDArray[np.int32] = np.zeros((2, 1 << 13), np.int32)
        self._ground_table: NDArray[np.int32] = np.zeros((2, 1 << 12), np.int32)
        self._grow(0, 1)

    def compact(self, returns: ClassifiedReturns, t_ns: int) -> CompactScan:
        """The compact form of a scan with the stamp t_ns; overwritten by the next one."""
        n, width = len(returns.label), returns.columns or max(len(returns.label), 1)
        if n > len(self._obstacle) or width > len(self._key):
            self._grow(n + n // 8, width)
        settings, blocking = self._settings, self._settings.blocking
        place = returns.lidar_base_m
        limits = np.array(
            [*place, *self._half_body_m, blocking.min_height_m, blocking.max_height_m, settings.reach_m,
             1 / max(THIN_M, self._least_cell_m), 1 / max(settings.ground_cell_m, self._least_cell_m),
             1 / self._unit_m], np.float32
        )  # fmt: skip
        arrays = returns.dx_m, returns.dy_m, returns.height_m, returns.label, returns.slot
        obstacles = self._obstacle, self._obstacle_count, self._obstacle_slot
        n_obstacles = _keep_obstacles(
            n, width, *arrays, limits, settings.counts, self._key, self._column, self._thin_table, *obstacles
        )
        ground = self._ground, self._ground_count, self._ground_slot
        arrays = returns.dx_m, returns.dy_m, returns.z_m, returns.label, returns.slot
        n_ground = _average_ground(n, *arrays, limits, self._ground_table, self._sums, *ground)
        rays = self._gatherer.gather(returns, self._half_body_m, self._unit_m, settings.reach_m, settings.highest_m)
        return CompactScan(
            t_ns=t_ns,
            slot_ns=t_ns + returns.slots.middle_ns,
            unit_m=self._unit_m,
            reach_m=settings.reach_m,
            lidar_base_m=place,
            level=is_level(returns.ground),
            shows_nothing=returns.shows_nothing,
            obstacle=_fixed(self._obstacle[:n_obstacles]),
            obstacle_count=_fixed(self._obstacle_count[:n_obstacles]),
            obstacle_slot=_fixed(self._obstacle_slot[:n_obstacles]),
            rays=Rays(*(_fixed(each[:]) for each in (rays.count, rays.slot, rays.reach, rays.slope))),
            ground=_fixed(self._ground[:n_ground]),
            ground_count=_fixed(self._ground_count[:n_ground]),
            ground_slot=_fixed(self._ground_slot[:n_ground]),
        )

    def _grow(self, room: int, width: int) -> None:
        self._key, self._column = np.zeros(width, np.int32), np.zeros(width + 1, np.int32)
        self._obstacle, self._ground = np.zeros((2, room, 3), np.int16)
        self._obstacle_count, self._obstacle_slot, self._ground_slot = np.zeros((3, room), np.uint8)
        self._ground_count, self._sums = np.zeros(room, np.uint16), np.zeros((room, 4), np.float32)


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
def _keep_obstacles(
    n: int, width: int, dx_m: Float32, dy_m: Float32, height_m: Float32, label: UInt8, slot: UInt8, limits: Float32,
    counts: bool, key: NDArray[np.int32], column: NDArray[np.int32], table: NDArray[np.int32], obstacle: Int16,
    count: UInt8, obstacle_slot: UInt8,
) -> int:  # fmt: skip
    """One of the points that block in each cell of THIN_M, with the greatest height of them.

    Of neighbours in a row that lie in one cell only the first is looked at, unless it matters how many there are.
    table: (2, power of two), which item was kept last of the cells that share a place in it; of two such cells that
    take turns some points are kept twice, which changes no map.
    """
    kept, mask = 0, np.int32(table.shape[1] - 1)
    x0, y0, per_unit = limits[_X], limits[_Y], limits[_PER_UNIT]
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
            item = np.uint32(table[0, at])
            if table[1, at] == cell and abs(np.int64(obstacle_slot[item]) - slots[c]) <= _SAME_TIME_SLOTS:
                obstacle[item, 2] = max(obstacle[item, 2], millimetres)
                count[item] += count[item] < MOST_COUNT
                continue
            item = np.uint32(kept)
            table[0, at], table[1, at] = kept, cell
            obstacle[item, 0] = np.int16(np.floor((dxs[c] + x0) * per_unit))
            obstacle[item, 1] = np.int16(np.floor((dys[c] + y0) * per_unit))
            obstacle[item, 2], count[item], obstacle_slot[item] = millimetres, 1, slots[c]
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
def _average_ground(
    n: int, dx_m: Float32, dy_m: Float32, z_m: Float32, label: UInt8, slot: UInt8, limits: Float32,
    table: NDArray[np.int32], sums: Float32, ground: Int16, count: UInt16, ground_slot: UInt8,
) -> int:  # fmt: skip
    """Means of the ground points of every cell; table as for `_keep_obstacles`, sums: (room, 4) x, y, z and count."""
    kept, mask = 0, np.int32(table.shape[1] - 1)
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
                ground_slot[item] = slot[i]
                kept += 1
        sums[item, 0] += x
        sums[item, 1] += y
        sums[item, 2] += z_m[i]
        sums[item, 3] += np.float32(1)
    per_unit, most = limits[_PER_UNIT], np.float32(32767)
    for item in range(kept):
        share = np.float32(1) / sums[item, 3]
        ground[item, 0] = np.int16(np.floor(sums[item, 0] * share * per_unit))
        ground[item, 1] = np.int16(np.floor(sums[item, 1] * share * per_unit))
        ground[item, 2] = np.int16(np.rint(min(max(sums[item, 2] * share * np.float32(1000), -most), most)))
        count[item] = np.uint16(sums[item, 3])
    return kept
