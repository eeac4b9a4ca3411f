"""Point clouds, of PointCloud2 and Livox messages, with the fields that may hold the times of their points."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import DecodeError
from quadlog.messages import PointCloud
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.payload import Header, Payload, PayloadReader
from quadlog.recordings.decoders.rows import Warn

TIME_NAME = re.compile(r".*(time|stamp).*|d?ts?|(t_?)?offset(_?t)?|(t|offset)_?[mun]?s(ec)?", re.IGNORECASE)
LARGEST_SHIFT_NS = 1_000_000_000


# Names that drivers give the beam index.
RING_FIELDS = ("ring", "channel", "line", "laser_id", "laserid", "beam", "ring_id", "row")


Fields = Mapping[str, tuple[int, str]]
"""Name -> byte offset in a point and scalar type (of the first element where there are several)."""


class Block(NamedTuple):
    """Points in `size` bytes of a payload from byte `begin` on: rows x columns of them, steps in bytes."""

    payload: Payload
    begin: int
    size: int
    rows: int
    columns: int
    row_step: int
    point_step: int

    def wrong(self, fields: Fields) -> str:
        """Why it cannot be read: points lie outside the data, or fields outside a point; empty for a sound one."""
        _, _, size, rows, columns, row_step, point_step = self
        if point_step == 0 or (rows > 1 and row_step < columns * point_step):
            return f"point_step {point_step} and row_step {row_step} do not fit {columns} columns"
        needed = (rows - 1) * row_step + columns * point_step
        if needed > size:
            return f"{rows} x {columns} points of {point_step} bytes need {needed} bytes, data has {size}"
        for name, (offset, kind) in fields.items():
            if offset + np.dtype(kind).itemsize > point_step:
                return f"field {name} lies outside the point ({point_step} bytes)"
        missing = ", ".join(name for name in "xyz" if name not in fields)
        return missing and f"cloud without {missing}"


def cloud_from_block(topic: str, block: Block, fields: Fields, header: Header, points: bool = True) -> PointCloud:
    """A PointCloud, with coordinates as a view of the payload where they lie side by side in it, and with a ring only
    where a field gives plausible ones.

    points: False for a look at the stamp. Raises DecodeError for a block that cannot be read.
    """
    payload, begin, _, rows, columns, row_step, point_step = block
    read = {name: fields[name] for name in fields if name in ("x", "y", "z", *RING_FIELDS) or TIME_NAME.fullmatch(name)}
    if rows * columns and (wrong := block.wrong(read)):
        listed = f"; its fields: {', '.join(fields) or 'none'}" if wrong.startswith("cloud without") else ""
        raise DecodeError(topic, wrong + listed)
    if not rows * columns or not points:
        return PointCloud(*header, np.empty((0, 3), np.float32))
    offsets, kinds = zip(*read.values(), strict=True)
    dtype = np.dtype({"names": [*read], "formats": kinds, "offsets": offsets, "itemsize": point_step})  # type: ignore[call-overload]
    table = np.ndarray((rows, columns), dtype, payload, begin, (row_step, point_step)).reshape(-1)  # type: ignore[arg-type]
    x, y, z = (fields[axis][0] for axis in "xyz")
    in_a_row = rows == 1 or row_step == columns * point_step
    if in_a_row and z - y == y - x > 0 and all(dtype[axis] == np.float32 for axis in "xyz"):
        xyz_m = np.ndarray((len(table), 3), np.float32, payload, begin + x, (point_step, y - x))
    else:
        with np.errstate(over="ignore", invalid="ignore"):  # beyond float32 is infinity, which is no valid point
            xyz_m = np.stack([table[axis].astype(np.float32) for axis in "xyz"]).T
    ring = next((_rings(table[name]) for name in read if name in RING_FIELDS), None)
    times = {name: table[name] for name in read if TIME_NAME.fullmatch(name)}
    return PointCloud(*header, xyz_m, ring, time_fields=times)


def _rings(values: NDArray) -> NDArray[np.uint16] | None:
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        return None
    if values.dtype != np.uint8 and values.dtype != np.uint16 and (values.min() < 0 or values.max() > 0xFFFF):
        return None
    return values.astype(np.uint16, copy=False)


POINT_BYTES = 19  # offset_time, x, y, z, reflectivity, tag, line
CDR_STRIDE = 20  # each point starts on a multiple of its first field's four bytes


def decode_livox(channel: Channel, payload: Payload, points: bool = True) -> PointCloud:
    """One CustomMsg, whose line becomes ring; its size is checked before anything is allocated."""
    reader, topic = PayloadReader(payload, channel.message_encoding, channel.topic), channel.topic
    header = reader.header()
    timebase_ns = reader.whole("u8")
    reader.whole("u4")  # point_num, which the sequence's own length repeats
    reader.skip(1 + 3)  # lidar_id, rsvd
    count = reader.whole("u4")
    stride = POINT_BYTES if reader.ros1 else CDR_STRIDE
    size = max(0, count * stride - (stride - POINT_BYTES))
    begin = reader.skip(size)
    if len(payload) - reader.at > 3:
        raise DecodeError(topic, f"{len(payload) - reader.at} bytes more than its {count} points need")
    # The closing padding of the last point is not sent, so the block's own step stops at its last byte.
    block = Block(payload, begin, size, count, 1, stride, POINT_BYTES)
    fields = {"offset_time": (0, "u4"), "x": (4, "f4"), "y": (8, "f4"), "z": (12, "f4"), "line": (18, "u1")}
    ordered = {name: (offset, reader.order + kind) for name, (offset, kind) in fields.items()}
    cloud = cloud_from_block(topic, block, ordered, header, points)
    # Offsets count from timebase, which some drivers set apart from the header's stamp.
    zero_ns = timebase_ns - (header.stamp_ns or 0)
    if zero_ns == 0 or abs(zero_ns) > LARGEST_SHIFT_NS:
        return cloud
    return replace(cloud, time_fields={name: each + np.int64(zero_ns) for name, each in cloud.time_fields.items()})


# sensor_msgs/PointField datatypes 1 to 8.
DATATYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
MOST_FIELDS = 256
LEAST_M, MOST_M = 1e-30, 1e6
LEAST_ABSURD, MOST_ABSURD = 0.3, 0.05
"""Shares of unusual coordinates in the wrong byte order, in which it is half or more, and in the right one."""
LOOKED_AT_POINTS = 256


Layout = dict[str, tuple[int, int]]  # name -> (offset, datatype)


class PointCloud2Decoder:
    """A decoder of payloads encoded as ``ros1`` or ``cdr``; it raises DecodeError for one that is not whole.

    The last field list is remembered, byte for byte: the next message nearly always has the same one.
    warn: gets what was put right, in the same words for each cloud.
    """

    def __init__(self, channel: Channel, warn: Warn = lambda _: None) -> None:
        self.topic, self.encoding, self.warn = channel.topic, channel.message_encoding, warn
        self.known: tuple[int, int, bytes, Layout] | None = None

    def __call__(self, payload: Payload, points: bool = True) -> PointCloud:
        """One PointCloud2; sizes are checked against the payload before anything is allocated."""
        reader = PayloadReader(payload, self.encoding, self.topic)
        header = reader.header()
        rows, columns = reader.whole("u4"), reader.whole("u4")
        fields = self._fields(reader)
        order, other = "><" if reader.whole("u1") else "<>"
        point_step, row_step = reader.whole("u4"), reader.whole("u4")
        size = reader.whole("u4")
        begin = reader.skip(size)
        if rows <= 1 and row_step < columns * point_step:
            row_step = columns * point_step  # a single row needs none, and some drivers leave it at zero
        fits = row_step >= columns * point_step and (rows - 1) * row_step + columns * point_step <= size
        if rows > 1 and not fits and size % rows == 0 and size // rows >= columns * point_step:
            self.warn(f"{self.topic}: row_step does not fit the rows of the clouds; the length of their data gives it")
            row_step = size // rows
        block = Block(payload, begin, size, rows, columns, row_step, point_step)
        cloud = cloud_from_block(self.topic, block, _ordered(fields, order), header, points)
        if _absurd_share(cloud.xyz_m) >= LEAST_ABSURD:
            swapped = cloud_from_block(self.topic, block, _ordered(fields, other), header)
            if _absurd_share(swapped.xyz_m) <= MOST_ABSURD:
                self.warn(f"{self.topic}: is_bigendian is wrong; coordinates make sense in the other byte order alone")
                return swapped
        return cloud

    def _fields(self, reader: PayloadReader) -> Layout:
        begin = reader.at
        if self.known is not None:
            known_begin, known_end, known_bytes, fields = self.known
            if known_begin == begin and reader.payload[begin:known_end] == known_bytes:
                reader.at = known_end
                return fields
        fields = _read_fields(reader)
        self.known = (begin, reader.at, bytes(reader.payload[begin : reader.at]), fields)
        return fields


def _ordered(layout: Layout, order: str) -> Fields:
    return {name: (offset, order + DATATYPES[kind - 1]) for name, (offset, kind) in layout.items()}


def _absurd_share(xyz_m: NDArray) -> float:
    """Share of numbers that no lidar measures among the different coordinates (N, 3); NaN without any."""
    with np.errstate(invalid="ignore"):  # signalling NaN
        some_m = np.abs(xyz_m[:: max(len(xyz_m) // LOOKED_AT_POINTS, 1)].astype(np.float64))
    size_m = np.unique(some_m)  # drivers write one number for all that is no return
    size_m = size_m[np.isfinite(size_m)]
    return float(np.mean((size_m < LEAST_M) | (size_m > MOST_M))) if len(size_m) else np.nan


def _read_fields(reader: PayloadReader) -> Layout:
    """The field list at the cursor. The first element of an array field stands for it."""
    count = reader.whole("u4")
    if count > MOST_FIELDS:
        raise DecodeError(reader.topic, f"announces {count} point fields")
    fields: Layout = {}
    for _ in range(count):
        name, offset, datatype = reader.text(), reader.whole("u4"), reader.whole("u1")
        elements = reader.whole("u4")
        if not 1 <= datatype <= len(DATATYPES):
            raise DecodeError(reader.topic, f"field {name} has the unknown datatype {datatype}")
        if elements >= 1:
            fields.setdefault(name, (offset, datatype))
    return fields
