"""What decoders produce and stages consume, whatever container or message type it came from.

Single messages are small frozen dataclasses with the header's stamp (or None
where the message has none); `Timed` adds the instant on the clock the user
chose. Whole topics of small messages are gathered into column series.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.floating[Any]]
Float32 = NDArray[np.float32]
Int = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class PointCloud:
    """One lidar message, as it came: nothing filtered, nothing moved.

    xyz_m: (N, 3) float32 in frame_id, non-finite points included, best with each coordinate side by side in memory.
    ring: (N,) uint16 beam index, or None where the sensor gives none.
    offset_ns: (N,) int64 time of each point relative to stamp_ns, or None.
    """

    stamp_ns: int | None
    frame_id: str
    xyz_m: NDArray[np.float32]
    ring: NDArray[np.uint16] | None = None
    offset_ns: Int | None = None


@dataclass(frozen=True, slots=True)
class UwbRanges:
    """Ranges of one tag to K anchors, measured together.

    tag: id of the tag, None where only the topic tells it.
    anchor: (K,) int64 ids; range_m: (K,) float64; absent ranges are left out.
    first_path_gap_db: (K,) receiver power minus first-path power, or None; large means NLOS.
    """

    stamp_ns: int | None
    tag: int | None
    anchor: Int
    range_m: Float
    first_path_gap_db: Float | None = None


@dataclass(frozen=True, slots=True)
class Pose:
    """A pose of child_frame in frame_id: position_m (3,), quat_xyzw (4,)."""

    stamp_ns: int | None
    frame_id: str
    child_frame_id: str
    position_m: Float
    quat_xyzw: Float


@dataclass(frozen=True, slots=True)
class Odometry:
    """A pose as in Pose, and the twist in child_frame: linear_mps (3,), angular_radps (3,)."""

    stamp_ns: int | None
    frame_id: str
    child_frame_id: str
    position_m: Float
    quat_xyzw: Float
    linear_mps: Float
    angular_radps: Float


@dataclass(frozen=True, slots=True)
class Imu:
    """quat_xyzw (4,) or None where the sensor gives no orientation; angular_radps, linear_mps2 (3,)."""

    stamp_ns: int | None
    frame_id: str
    quat_xyzw: Float | None
    angular_radps: Float
    linear_mps2: Float


@dataclass(frozen=True, slots=True)
class Transforms:
    """The transforms of one TF message, each a Pose of child_frame in frame_id."""

    stamp_ns: int | None
    transforms: tuple[Pose, ...]
    static: bool


Message = PointCloud | UwbRanges | Pose | Odometry | Imu | Transforms


class Timed(NamedTuple):
    """A decoded message at t_ns on the clock the user chose (`--stamp`)."""

    t_ns: int
    topic: str
    message: Message


@dataclass(frozen=True, slots=True)
class RangeSeries:
    """All ranges of a recording, in time order; columns of equal length (N,)."""

    t_ns: Int
    tag: Int
    anchor: Int
    range_m: Float

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True, slots=True)
class PoseSeries:
    """Poses of one frame in another over time: t_ns (N,) strictly increasing, position_m (N, 3), quat_xyzw (N, 4)."""

    t_ns: Int
    position_m: Float
    quat_xyzw: Float
    frame_id: str = ""
    child_frame_id: str = ""

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True, slots=True)
class ImuSeries:
    """t_ns (N,) strictly increasing, angular_radps (N, 3), quat_xyzw (N, 4) or None; of and about frame_id's axes."""

    t_ns: Int
    angular_radps: Float
    quat_xyzw: Float | None
    frame_id: str = ""

    def __len__(self) -> int:
        return len(self.t_ns)
