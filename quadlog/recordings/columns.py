"""Small messages decoded by columns: many payloads in one pass of numpy, instead of a Python object for each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from quadlog.geometry import FARTHEST_M
from quadlog.messages import Float, Imu, Int, Odometry, Pose, UwbRanges
from quadlog.recordings.payload_layout import Flat, Layout, Misfit, Wanted, learn_layout

KEPT_LAYOUTS = 16
LARGEST_BYTES = 1 << 14
"""Larger payloads are no small messages: they are decoded one by one."""

MessageKind = type[Imu] | type[Odometry] | type[Pose] | type[UwbRanges]


class Columns(NamedTuple):
    """N messages of a kind that name the same frames; stamp_ns (N,), None without stamps; values (N, W).

    values of a Pose: position and quaternion; of an Odometry linear and angular velocity behind them; of an Imu angular
    velocity and quaternion, NaN without one; of UwbRanges the tag and its distances to anchors 0, 1, …, 0 for none.
    """

    kind: MessageKind
    stamp_ns: Int | None
    values: Float
    frame_id: str = ""
    child_frame_id: str = ""


InColumns = Callable[[tuple[str, ...], Float], tuple[list[Columns], np.ndarray]]
"""From wanted texts and numbers (N, K) to columns, several where a message holds several, and which rows (N,) are
sound; what is unsound is decoded once more by itself."""
Ways = Sequence[tuple[Wanted, InColumns]]


def stamps_ns(numbers: Float) -> Int:
    """(N,) nanoseconds of (N, 2) seconds and nanoseconds."""
    seconds, nanos = numbers.astype(np.int64).T
    stamps: Int = seconds * 1_000_000_000 + nanos
    return stamps


def unit_rows(quat_xyzw: Float) -> tuple[Float, np.ndarray]:
    """Quaternions (N, 4) at unit length, all zeros as no rotation; and (N,) which are finite."""
    x, y, z, w = quat_xyzw.T
    length = np.sqrt(x * x + y * y + z * z + w * w)
    unit = quat_xyzw / length[:, None]
    unit[length == 0] = (0.0, 0.0, 0.0, 1.0)
    return unit, np.isfinite(length)


def reachable_rows(position_m: Float) -> np.ndarray:
    """(N,) which positions (N, 3) are finite and no farther out than FARTHEST_M."""
    reachable: np.ndarray = np.all(np.abs(position_m) <= FARTHEST_M, axis=1)
    return reachable


class ColumnDecoder:
    """Decodes payloads of one channel that follow a definition which has a layout."""

    def __init__(self, fields: tuple[Flat, ...], encoding: str, in_columns: InColumns) -> None:
        self._fields, self._encoding, self._in_columns = fields, encoding, in_columns
        self._known: dict[int, list[Layout]] = {}

    def learn(self, payload: bytes) -> Layout:
        """The layout of a payload, kept for others like it. Raises Misfit."""
        layout = learn_layout(self._fields, payload, self._encoding)
        if sum(map(len, self._known.values())) == KEPT_LAYOUTS:
            self._known.clear()
        self._known.setdefault(len(payload), []).append(layout)
        return layout

    def decode(self, payloads: Sequence[bytes]) -> Iterator[tuple[Int, list[Columns]]]:
        """Rows (N,) of the payloads, and their columns of that length; rows that are left out do not follow."""
        sizes = list(map(len, payloads))
        for size in sorted(set(sizes)):
            rows = np.flatnonzero(np.array(sizes) == size)
            together = (
                b"".join(payloads) if len(rows) == len(payloads) else b"".join(payloads[i] for i in rows.tolist())
            )
            yield from self._decode_alike(rows, np.frombuffer(together, np.uint8).reshape(len(rows), size))

    def _decode_alike(self, rows: Int, payloads: np.ndarray) -> Iterator[tuple[Int, list[Columns]]]:
        known = list(self._known.get(payloads.shape[1], ()))
        while len(rows):
            try:
                layout = known.pop(0) if known else self.learn(payloads[0].tobytes())
            except Misfit:
                rows, payloads = rows[1:], payloads[1:]
                continue
            fits = layout.fits(payloads)
            if not fits.any():
                continue
            fitting = payloads if fits.all() else np.ascontiguousarray(payloads[fits])
            with np.errstate(all="ignore"):
                columns, sound = self._in_columns(layout.texts, layout.values(fitting))
            if sound.all():
                yield rows[fits], columns
            elif sound.any():
                yield rows[fits][sound], [_picked(each, sound) for each in columns]
            rows, payloads = rows[~fits], payloads[~fits]


def _picked(columns: Columns, rows: np.ndarray) -> Columns:
    stamp_ns = None if columns.stamp_ns is None else columns.stamp_ns[rows]
    return columns._replace(stamp_ns=stamp_ns, values=columns.values[rows])
