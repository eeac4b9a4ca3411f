"""Messages as rows: what the table of types (`quadlog.recordings.types`) is made of."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import ROWS, UNPLACED, Float, Int, Message, PointCloud, UwbRanges
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.fields import Columns
from quadlog.recordings.decoders.joints import JointOrder
from quadlog.recordings.decoders.payload import Payload
from quadlog.recordings.decoders.ros_messages import Definitions


class Part(NamedTuple):
    """Rows (R,) of one kind, of some messages.

    of: (R,) which message each row is of, None: row i of message i. stamp_ns: (N,) of the messages, frames: of all of
    them; None: as their headers have it. unmeasured: as in Batch.
    """

    kind: type[Message]
    rows: NDArray[np.void]
    of: Int | None = None
    stamp_ns: Int | None = None
    frames: tuple[str, str] | None = None
    unmeasured: str = ""


class Type(NamedTuple):
    """kinds: what a message becomes, the main one first; wanted: column -> path; rows: from columns to parts.

    rows raises DecodeError, or what a definition of another shape makes numpy raise. unit: of its ranges.
    """

    kinds: tuple[type[Message], ...]
    wanted: Mapping[str, str]
    rows: Callable[[Columns, JointOrder], Iterator[Part]]
    unit: str = "m"


Warn = Callable[[str], object]


class Clouds(NamedTuple):
    """A type whose clouds are decoded one by one.

    decoder: from a channel, where definitions are looked up, and what gets what is put right, to a function from a
    payload, and whether points are wanted or only the stamp, to a cloud. Both raise DecodeError.
    """

    decoder: Callable[[Channel, Definitions, Warn], Callable[[Payload, bool], PointCloud]]
    gives: type[Message] = PointCloud


HEADER = {"sec": "header.stamp.sec ?", "nanosec": "header.stamp.nanosec ?", "frame": "header.frame_id ?"}
OWN_HEADER = {column: path.replace(" ?", f" | {path[7:]}") for column, path in HEADER.items()}
"""Of a type that a user describes, whose stamp may lie at its top."""


def part(kind: type[Message], n: int, *, of: Int | None = None, unmeasured: str = "", **values: Any) -> Part:
    """A part of n rows with these values."""
    rows = np.zeros(n, UNPLACED if kind is UwbRanges and "anchor_position_m" not in values else ROWS[kind])
    for name, value in values.items():
        rows[name] = value
    return Part(kind, rows, of, unmeasured=unmeasured)


NO_TURN = (0.0, 0.0, 0.0, 1.0)


def unit_rows(quat_xyzw: Float) -> tuple[Float, np.ndarray]:
    """Quaternions (..., 4) at unit length, all zeros as no rotation; and (...,) which are finite."""
    x, y, z, w = np.moveaxis(quat_xyzw, -1, 0)
    with np.errstate(all="ignore"):
        length = np.sqrt(x * x + y * y + z * z + w * w)
        unit = quat_xyzw / length[..., None]
    unit[length == 0] = NO_TURN
    return unit, np.isfinite(length)
