"""What decoders produce and stages consume, whatever container or message type it came from.

Single messages are small frozen dataclasses with the header's stamp (or None
where the message has none); `Timed` adds the instant on the clock the user
chose. Small messages are read as rows, many at once (`Batch`); `gather`
makes series over time of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.floating[Any]]
Float32 = NDArray[np.float32]
Int = NDArray[np.int64]

NS_PER_S = 1_000_000_000
GRAVITY_MPS2 = 9.81
UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Metres in each unit that ranges come in."""


@dataclass(frozen=True, slots=True)
class PointTimes:
    """When the points of a cloud were measured, as the sensor says it.

    That is (value - zero) * scale - shift_ns, in nanoseconds, after the stamp. value: (N,) finite numbers. first_ns,
    last_ns: the least and the greatest of the times.
    """

    value: NDArray[Any]
    first_ns: int
    last_ns: int
    zero: float = 0.0
    scale: float = 1.0
    shift_ns: float = 0.0

    @classmethod
    def of_offsets(cls, offset_ns: Int) -> Self:
        """Times that are given in nanoseconds after the stamp already."""
        values = np.asarray(offset_ns)
        low, high = (int(values.min()), int(values.max())) if values.size else (0, 0)
        return cls(values, low, high)

    def __len__(self) -> int:
        return len(self.value)

    @property
    def offset_ns(self) -> Int:
        """(N,) int64 relative to the stamp."""
        if self.value.dtype.kind != "f" and (self.zero, self.scale) == (0.0, 1.0):
            return self.value.astype(np.int64) - round(self.shift_ns)
        offsets: Int = np.rint((self.value.astype(np.float64) - self.zero) * self.scale - self.shift_ns)
        return offsets.astype(np.int64)


@dataclass(frozen=True, slots=True, init=False)
class PointCloud:
    """One lidar message, as it came: nothing filtered, nothing moved.

    xyz_m: (N, 3) float32 in frame_id, non-finite points included; often a view of the message's payload.
    ring: (N,) uint16 beam index, or None where the sensor gives none; may be a view as well.
    times: of each point, or None. They can also be given as offset_ns, (N,) int64 relative to stamp_ns.
    time_fields: name -> (N,) values that may be times, in a unit and from a zero that are still to be found.
    """

    stamp_ns: int | None
    frame_id: str
    xyz_m: NDArray[np.float32]
    ring: NDArray[np.uint16] | None
    times: PointTimes | None
    time_fields: Mapping[str, NDArray[Any]]

    def __init__(
        self,
        stamp_ns: int | None,
        frame_id: str,
        xyz_m: NDArray[np.float32],
        ring: NDArray[np.uint16] | None = None,
        offset_ns: Int | None = None,
        times: PointTimes | None = None,
        time_fields: Mapping[str, NDArray[Any]] = MappingProxyType({}),
    ) -> None:
        given = times if offset_ns is None else PointTimes.of_offsets(offset_ns)
        values = (stamp_ns, frame_id, xyz_m, ring, given, time_fields)
        for name, value in zip(self.__slots__, values, strict=True):
            object.__setattr__(self, name, value)

    @property
    def offset_ns(self) -> Int | None:
        """(N,) int64 time of each point relative to stamp_ns, or None."""
        return None if self.times is None else self.times.offset_ns


@dataclass(frozen=True, slots=True)
class UwbRanges:
    """Ranges of one tag to K anchors, measured together.

    tag: id of the tag, None where only the topic identifies it.
    anchor: (K,) int64 ids; range_m: (K,) float64; absent ranges are left out.
    first_path_gap_db: (K,) receiver power minus first-path power, or None; large means NLOS.
    anchor_position_m: (K, 3) where the anchors are in map, NaN or zero where unknown, or None.
    unmeasured: why the one range of the message, which is left out, was not measured by what the message itself says.
    """

    stamp_ns: int | None
    tag: int | None
    anchor: Int
    range_m: Float
    first_path_gap_db: Float | None = None
    anchor_position_m: Float | None = None
    unmeasured: str = ""


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
class Twist:
    """A velocity that is wanted, in the body: linear_mps (3,), angular_radps (3,)."""

    stamp_ns: int | None
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


@dataclass(frozen=True, slots=True)
class JointStates:
    """Joints and feet of a quadruped at one instant, NaN where a value is not given.

    position_rad, velocity_radps, torque_nm: (12,) legs FL, FR, RL, RR, of each hip, thigh, calf. All zero is a leg
    straight down; the hip turns about the body's x axis, thigh and calf about its y axis (left), as in the URDF files
    of Unitree's robots: a calf's angle is negative. foot_force_n: (4,) normal forces, FL, FR, RL, RR. tick: of the
    device's own clock, in its unit and modulo TICKS.
    """

    stamp_ns: int | None
    position_rad: Float
    velocity_radps: Float
    torque_nm: Float
    foot_force_n: Float
    tick: float = np.nan


TICKS = 1 << 24
"""Float32 holds all numbers below; it divides 2^32, at which devices' ticks wrap."""
Message = PointCloud | UwbRanges | Pose | Odometry | Twist | Imu | Transforms | JointStates

NO_ID = -1
"""Of a tag or an anchor that neither the message nor its topic names."""
_XYZ, _POSE = ("f8", 3), (("position_m", "f8", 3), ("quat_xyzw", "f8", 4))


def _rows(*fields: tuple[Any, ...]) -> np.dtype[np.void]:
    return np.dtype([("order", "i8"), ("t_ns", "i8"), *fields])


UNPLACED = _rows(("tag", "i8"), ("anchor", "i8"), ("range_m", "f8"), ("first_path_gap_db", "f8"))
"""Rows of ranges whose messages do not say where anchors are: half the memory."""
ROWS: dict[type[Message], np.dtype[np.void]] = {
    UwbRanges: np.dtype([*UNPLACED.descr, ("anchor_position_m", *_XYZ)]),
    Pose: _rows(*_POSE),
    Odometry: _rows(*_POSE, ("linear_mps", *_XYZ), ("angular_radps", *_XYZ)),
    Twist: _rows(("linear_mps", *_XYZ), ("angular_radps", *_XYZ)),
    Imu: _rows(("quat_xyzw", "f8", 4), ("angular_radps", *_XYZ), ("linear_mps2", *_XYZ)),
    Transforms: _rows(*_POSE, ("index", "i8")),
    JointStates: _rows(
        *((name, "f4", 12) for name in ("position_rad", "velocity_radps", "torque_nm")),
        ("foot_force_n", "f4", 4),
        ("tick", "f4"),
    ),
}
"""Small messages as rows of a structured array, each a range, a transform or a message, with the fields of their
classes; NaN or NO_ID where there is none. order: grows with log time; t_ns: on the chosen clock; both are set by who
reads; index: of a transform in its message."""


class Batch(NamedTuple):
    """Rows (N,) of one kind and topic, whose messages name the same frames.

    log_ns: (N,) when they were logged; stamp_ns: (N,) header stamps, None without. unmeasured: why none of the rows,
    which are ranges, was measured, as their messages say; empty for all others.
    """

    kind: type[Message]
    topic: str
    rows: NDArray[np.void]
    log_ns: Int
    stamp_ns: Int | None
    frame_id: str = ""
    child_frame_id: str = ""
    unmeasured: str = ""


class Timed(NamedTuple):
    """A decoded message at t_ns on the clock the user chose (`--stamp`)."""

    t_ns: int
    topic: str
    message: Message


@dataclass(frozen=True, slots=True)
class Series:
    """Columns of equal length (N,) or (N, K) over time."""

    t_ns: Int

    def __len__(self) -> int:
        return len(self.t_ns)

    def rows(self, rows: np.ndarray | slice) -> Self:
        """Those of a mask, of indices or of a slice."""
        columns = {each.name: getattr(self, each.name) for each in fields(self)}
        return replace(self, **{name: each[rows] for name, each in columns.items() if isinstance(each, np.ndarray)})


@dataclass(frozen=True, slots=True)
class RangeSeries(Series):
    """All ranges of a recording, in time order."""

    tag: Int
    anchor: Int
    range_m: Float


@dataclass(frozen=True, slots=True)
class PoseSeries(Series):
    """Poses of one frame in another over time: t_ns (N,) strictly increasing, position_m (N, 3), quat_xyzw (N, 4)."""

    position_m: Float
    quat_xyzw: Float
    frame_id: str = ""
    child_frame_id: str = ""


@dataclass(frozen=True, slots=True)
class ImuSeries(Series):
    """t_ns (N,) strictly increasing, angular_radps (N, 3), quat_xyzw (N, 4) or None; of and about frame_id's axes."""

    angular_radps: Float
    quat_xyzw: Float | None
    frame_id: str = ""


@dataclass(frozen=True, slots=True)
class TwistSeries(Series):
    """Commands of a body: twist (N, 3), speeds ahead and to the left in m/s, and yaw rate in rad/s."""

    twist: Float


@dataclass(frozen=True, slots=True)
class JointSeries(Series):
    """Joints over time: t_ns (N,) strictly increasing, the rest as in JointStates, with N rows."""

    position_rad: Float
    velocity_radps: Float
    torque_nm: Float
    foot_force_n: Float
