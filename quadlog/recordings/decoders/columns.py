"""Small messages decoded by columns: the layout of a type is learned once, then many payloads are one pass of numpy."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype

from quadlog.geometry import FARTHEST_M
from quadlog.messages import NS_PER_S, Float, Imu, Int, JointStates, Odometry, Pose, UwbRanges
from quadlog.recordings.decoders.type_definitions import Types

Wanted = Mapping[str, int]
"""Path of a field -> how many of its elements are wanted; TEXT for a string, WHOLE for one whole number of at most 32
bits, EVERY for all numbers of a sequence, behind their count, or all its strings; ABSENT where there must be no such
field. In the order of the definition."""
TEXT, ABSENT, WHOLE, EVERY = 0, -1, -2, -3

DTYPES = {"bool": "?", "byte": "u1", "char": "u1", "float32": "f4", "float64": "f8"} | {
    f"{kind}{8 * size}": f"{kind[0]}{size}" for kind in ("int", "uint") for size in (1, 2, 4, 8)
}
CDR_ORDER = {b"\0\0": ">", b"\0\1": "<"}
CDR_SLACK = 3  # bytes by which writers may fill a payload up


AS_SENT = -1


class Misfit(ValueError):
    """A payload that does not follow its definition."""


class Flat(NamedTuple):
    """A dtype repeated, of which the first few are wanted; a string where the dtype is "s"; a list of elements.

    repeated: AS_SENT for a sequence, whose payload gives the number. wanted: EVERY for all of a sequence.
    """

    dtype: str
    repeated: int = 1
    wanted: int = 0
    elements: tuple[Flat, ...] = ()


def each_of(path: str, names: str) -> dict[str, int]:
    """`a.x` and `a.y` for the path `a` and the names `xy`: one number for each name."""
    return {f"{path}.{name}": 1 for name in names}


def header_of(path: str) -> dict[str, int]:
    """Both numbers of the stamp and the frame's name of a std_msgs/Header."""
    return {f"{path}.stamp.sec": WHOLE, f"{path}.stamp.nanosec": WHOLE, f"{path}.frame_id": TEXT}


def flat_fields(types: Types, type_name: str, wanted: Wanted) -> tuple[Flat, ...] | None:
    """A type's fields without the types between; None where other kinds are among them, or not those that are wanted.

    types: a checked table (`needed_types`), in which no type contains itself.
    """
    found: list[tuple[str, int]] = []
    flat = _flat(types, type_name, "", wanted, found)
    return flat if found == [each for each in wanted.items() if each[1] != ABSENT] else None


def _flat(
    types: Types, name: str, prefix: str, wanted: Wanted, found: list[tuple[str, int]]
) -> tuple[Flat, ...] | None:
    flat: list[Flat] = []
    for field_name, (kind, detail) in types[name][1]:
        path = prefix + field_name
        inner: tuple[Flat, ...] | None
        if kind == Nodetype.NAME:
            inner = _flat(types, detail, f"{path}.", wanted, found)
        elif kind in (Nodetype.SEQUENCE, Nodetype.ARRAY) and detail[0][0] == Nodetype.NAME:
            elements = _flat(types, detail[0][1], f"{path}.", wanted, found)
            count = AS_SENT if kind == Nodetype.SEQUENCE else detail[1]
            inner = elements and (Flat("", count, elements=elements),)
        else:
            inner = _basic(kind, detail, wanted.get(path))
            found += [(path, wanted[path])] if path in wanted else []
        if not inner:
            return None
        flat += inner
    return tuple(flat)


def _basic(kind: Nodetype, detail: Any, wanted: int | None) -> tuple[Flat] | None:
    if kind == Nodetype.SEQUENCE:
        return _sequence(detail[0][1][0], wanted)
    if kind == Nodetype.BASE and detail[0] == "string" and wanted in (None, TEXT):
        return (Flat("s", wanted=int(wanted == TEXT)),)
    (_, detail), count = detail if kind == Nodetype.ARRAY else ((kind, detail), 1)
    dtype = DTYPES.get(detail[0])
    if dtype is None or wanted in (TEXT, EVERY) or count < max(wanted or 0, 1):
        return None
    if (wanted == WHOLE and dtype not in ("i1", "u1", "i2", "u2", "i4", "u4")) or (wanted and dtype == "?"):
        return None
    return (Flat(dtype, count, 1 if wanted == WHOLE else wanted or 0),)


def _sequence(base: str, wanted: int | None) -> tuple[Flat] | None:
    dtype = "s" if base == "string" else DTYPES.get(base)
    if dtype is None or wanted not in (None, EVERY) or (wanted and dtype == "?"):
        return None
    return (Flat(dtype, AS_SENT, wanted or 0),)


@dataclass(frozen=True, slots=True)
class Layout:
    """Payloads of one size that hold the same strings and lengths.

    fixed: (begin, content) of what must be the same in all. texts: the wanted strings. numbers: (begin, dtype, count)
    of stretches of wanted numbers.
    """

    fixed: tuple[tuple[int, bytes], ...]
    texts: tuple[str, ...]
    numbers: tuple[tuple[int, str, int], ...]

    def fits(self, payloads: np.ndarray) -> np.ndarray:
        """(N,) bool: which of payloads (N, size) uint8 have this layout."""
        fitting = np.ones(len(payloads), dtype=bool)
        for begin, content in self.fixed:
            same = payloads[:, begin : begin + len(content)] == np.frombuffer(content, np.uint8)
            fitting &= same.all(axis=1)
        return fitting

    def values(self, payloads: np.ndarray) -> Float:
        """(N, K) float64: the wanted numbers of C-contiguous payloads (N, size) uint8."""
        values = np.empty((len(payloads), sum(count for _, _, count in self.numbers)))
        at = 0
        for begin, dtype, count in self.numbers:
            strides = (payloads.shape[1], np.dtype(dtype).itemsize)
            values[:, at : at + count] = np.ndarray((len(payloads), count), dtype, payloads, begin, strides)
            at += count
        return values


@dataclass
class _Walk:
    """A way along one payload, and what it meets."""

    payload: bytes
    cdr: bool
    at: int = 0
    order: str = "<"
    fixed: list[tuple[int, bytes]] = field(default_factory=list)
    numbers: list[tuple[int, str, int]] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        if self.cdr:
            mark = self.payload[:2]
            if mark not in CDR_ORDER:
                raise Misfit(f"not a plain CDR payload (starts with {mark.hex() or 'nothing'})")
            self.order = CDR_ORDER[mark]
            self._skip(4)
            self.fixed.append((0, mark))

    def along(self, fields: tuple[Flat, ...]) -> None:
        """Over the fields; raises Misfit where the payload ends before them."""
        for each in fields:
            count = each.repeated
            if count == AS_SENT:
                count = self._length(wanted=each.wanted == EVERY and each.dtype != "s")
            if each.elements:
                for _ in range(count):
                    self.along(each.elements)
            elif each.dtype == "s":
                for _ in range(count):
                    self._string(wanted=bool(each.wanted))
            elif count:  # an empty sequence is not aligned
                wanted = count if each.wanted == EVERY else each.wanted
                self._numbers(np.dtype(self.order + each.dtype), count, wanted)

    def _numbers(self, dtype: np.dtype, count: int, wanted: int) -> None:
        self._align(dtype.itemsize)
        begin = self.at
        self._skip(count * dtype.itemsize)
        if wanted:
            self._want(begin, dtype, wanted)

    def _want(self, begin: int, dtype: np.dtype, wanted: int) -> None:
        if self.numbers:
            last_begin, last_dtype, last_count = self.numbers[-1]
            if last_dtype == dtype.str and last_begin + last_count * dtype.itemsize == begin:
                self.numbers[-1] = (last_begin, last_dtype, last_count + wanted)
                return
        self.numbers.append((begin, dtype.str, wanted))

    def _string(self, *, wanted: bool) -> None:
        length = self._length()
        begin = self.at
        self._skip(length)
        raw = self.payload[begin : self.at]
        if self.cdr and raw[-1:] != b"\0":
            raise Misfit("a string does not end with its zero byte")
        try:
            text = (raw[:-1] if self.cdr else raw).decode()
        except UnicodeDecodeError:
            raise Misfit("a string is not UTF-8") from None
        self.fixed.append((begin, raw))
        self.texts += [text] if wanted else []

    def _length(self, *, wanted: bool = False) -> int:
        self._align(4)
        begin = self.at
        self._skip(4)
        raw = self.payload[begin : self.at]
        self.fixed.append((begin, raw))
        if wanted:
            self._want(begin, np.dtype(f"{self.order}u4"), 1)
        return int.from_bytes(raw, "little" if self.order == "<" else "big")

    def _align(self, size: int) -> None:
        # CDR counts from behind its four first bytes, which are a multiple of four alone.
        if self.cdr:
            self._skip((4 - self.at) % size)

    def _skip(self, size: int) -> None:
        self.at += size
        if self.at > len(self.payload):
            raise Misfit(f"it ends after {len(self.payload)} bytes, in the middle of a field")


KEPT_LAYOUTS = 16
LARGEST_BYTES = 1 << 14
"""Larger payloads are no small messages: they are decoded one by one."""

MessageKind = type[Imu] | type[JointStates] | type[Odometry] | type[Pose] | type[UwbRanges]


class Columns(NamedTuple):
    """N messages of a kind that name the same frames; stamp_ns (N,), None without stamps; values (N, W).

    values of a Pose: position and quaternion; of an Odometry linear and angular velocity behind them; of an Imu angular
    velocity and quaternion, NaN without one; of UwbRanges the tag and its distances to anchors 0, 1, …, 0 for none; of
    JointStates its five fields one after the other.
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
    stamps: Int = seconds * NS_PER_S + nanos
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
        """The layout of a payload, kept for others like it. Raises Misfit for all that rosbags would refuse."""
        walk = _Walk(payload, self._encoding != "ros1")
        walk.along(self._fields)
        left = len(payload) - walk.at
        if left > (CDR_SLACK if walk.cdr else 0):
            raise Misfit(f"{left} bytes are left over")
        layout = Layout(tuple(walk.fixed), tuple(walk.texts), tuple(walk.numbers))
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
