"""What a map needs of a classified scan before the robot's poses are known, in some tens of kilobytes.

Everything lies in base, levelled by the tilt at the time of the scan, and is not deskewed: each item carries the time
slot in which it was measured, so that one rigid transform per slot puts it where it was.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from quadlog.lidar.ground import is_level
from quadlog.lidar.points import PointClass
from quadlog.lidar.scan_classifier import ClassifiedReturns
from quadlog.mapping.obstacles import ObstacleSettings
from quadlog.messages import Float, Int

Int16 = NDArray[np.int16]
UInt16 = NDArray[np.uint16]
UInt8 = NDArray[np.uint8]

_HEADER = struct.Struct("<q d 3d ?? B x H I I I")


@dataclass(frozen=True, slots=True)
class CompactSettings:
    """blocking: what counts as an obstacle; reach_m: nothing farther from the lidar is kept, as the window's half diagonal.

    ground_cell_m: edge of the cells over which ground returns are averaged.
    """

    blocking: ObstacleSettings
    reach_m: float = 15.0
    ground_cell_m: float = 0.2


@dataclass(frozen=True, slots=True)
class CompactScan:
    """One scan, ready to be placed in map; lengths are in units of unit_m, heights are above the ground, in mm.

    slot_ns: (K,) absolute instants of the middles of the time slots. lidar_base_m: (3,) x, y in base and height above
    the ground. obstacle: (N, 3) x, y, height of the highest of obstacle_count (N,) points that were next to each other.
    ray_reach, ray_slope: (R,) horizontal length, and rise per length in 1/8192, of the rays of each of the sectors,
    of which sector s has the next ray_count[s]; sector s looks along (s + 1/2) / S turns in base.
    ground: (G, 3) x, y and z in mm, the mean of ground_count (G,) points of a cell.
    level: whether the ground may be added to the run's ground. shows_nothing: whether maps must not use the scan.
    """

    t_ns: int
    slot_ns: Int
    unit_m: float
    lidar_base_m: Float
    level: bool
    shows_nothing: bool
    obstacle: Int16
    obstacle_count: UInt8
    obstacle_slot: UInt8
    ray_count: UInt8
    ray_sector_slot: UInt8
    ray_reach: UInt16
    ray_slope: Int16
    ground: Int16
    ground_count: UInt16
    ground_slot: UInt8

    def to_bytes(self) -> bytes:
        """A fixed header and the arrays, one after the other; `from_bytes` reads it."""
        sizes = len(self.obstacle), len(self.ray_reach), len(self.ground)
        flags = self.level, self.shows_nothing, len(self.slot_ns)
        header = _HEADER.pack(self.t_ns, self.unit_m, *self.lidar_base_m, *flags, len(self.ray_count), *sizes)
        return b"".join([header, *(getattr(self, name).tobytes() for name, _, _ in _ARRAYS)])

    @classmethod
    def from_bytes(cls, data: bytes | memoryview) -> Self:
        """The scan that `to_bytes` wrote. Its arrays are views of data."""
        t_ns, unit_m, x_m, y_m, z_m, level, nothing, slots, sectors, n, rays, ground = _HEADER.unpack_from(data)
        lengths = {"slots": slots, "sectors": sectors, "obstacles": n, "rays": rays, "ground": ground}
        arrays, at = {}, _HEADER.size
        for name, dtype, (length, *rest) in _ARRAYS:
            shape = (lengths[length], *rest)
            count = int(np.prod(shape))
            arrays[name] = np.frombuffer(data, dtype, count, at).reshape(shape)
            at += arrays[name].nbytes
        place = np.array([x_m, y_m, z_m])
        return cls(t_ns=t_ns, unit_m=unit_m, lidar_base_m=place, level=level, shows_nothing=nothing, **arrays)


_ARRAYS: list[tuple[str, str, tuple]] = [
    ("slot_ns", "<i8", ("slots",)),
    ("obstacle", "<i2", ("obstacles", 3)),
    ("ray_reach", "<u2", ("rays",)),
    ("ray_slope", "<i2", ("rays",)),
    ("ground", "<i2", ("ground", 3)),
    ("ground_count", "<u2", ("ground",)),
    ("obstacle_count", "<u1", ("obstacles",)),
    ("obstacle_slot", "<u1", ("obstacles",)),
    ("ray_count", "<u1", ("sectors",)),
    ("ray_sector_slot", "<u1", ("sectors",)),
    ("ground_slot", "<u1", ("ground",)),
]


def compact_scan(returns: ClassifiedReturns, t_ns: int, settings: CompactSettings) -> CompactScan:
    """What a map needs of a classified scan with its stamp t_ns."""
    unit_m = max(settings.reach_m, 1.0) * 2 / 32000
    away_m = np.hypot(returns.x_m - returns.lidar_base_m[0], returns.y_m - returns.lidar_base_m[1])
    near = away_m <= settings.reach_m
    blocking = settings.blocking
    half_m = np.array([blocking.body_length_m, blocking.body_width_m]) / 2 + blocking.body_margin_m
    beside = (np.abs(returns.x_m) > half_m[0]) | (np.abs(returns.y_m) > half_m[1])
    high = (returns.height_m >= blocking.min_height_m) & (returns.height_m <= blocking.max_height_m)
    hit = near & high & beside & (returns.label == PointClass.OBSTACLE)
    ground = near & (returns.label == PointClass.GROUND)

    def points(which: NDArray[np.bool_], height_m: NDArray) -> Int16:
        columns = returns.x_m[which] / unit_m, returns.y_m[which] / unit_m, height_m[which] * 1000
        return np.clip(np.rint(np.column_stack(columns)), -32767, 32767).astype(np.int16)

    return CompactScan(
        t_ns=t_ns,
        slot_ns=t_ns + returns.slots.middle_ns,
        unit_m=unit_m,
        lidar_base_m=returns.lidar_base_m,
        level=is_level(returns.ground),
        shows_nothing=returns.shows_nothing,
        obstacle=points(hit, returns.height_m),
        obstacle_count=np.ones(np.count_nonzero(hit), np.uint8),
        obstacle_slot=returns.slot[hit],
        ray_count=np.zeros(64, np.uint8),
        ray_sector_slot=np.zeros(64, np.uint8),
        ray_reach=np.zeros(0, np.uint16),
        ray_slope=np.zeros(0, np.int16),
        ground=points(ground, returns.z_m),
        ground_count=np.ones(np.count_nonzero(ground), np.uint16),
        ground_slot=returns.slot[ground],
    )
