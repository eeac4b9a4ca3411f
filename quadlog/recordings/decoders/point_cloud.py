"""Point clouds, of PointCloud2 and Livox messages, with the fields that may hold the times of their points."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import DecodeError
from quadlog.messages import PointCloud
from quadlog.recordings.decoders.payload import Payload, PayloadReader

TIME_NAME = re.compile(r".*(time|stamp).*|d?ts?|(t_?)?offset(_?t)?|(t|offset)_?[mun]?s(ec)?", re.IGNORECASE)
LARGEST_SHIFT_NS = 1_000_000_000


# Names that drivers give the beam index.
RING_FIELDS = ("ring", "channel", "line", "laser_id", "laserid", "beam", "ring_id", "row")


class Column(NamedTuple):
    """One field of a point: byte offset and scalar type (first element where count > 1)."""

    offset: int
    dtype: np.dtype


@dataclass(frozen=True, slots=True)
class Block:
    """Points in a payload: rows x columns of them from byte `begin` on, strides in bytes."""

    payload: Payload
    begin: int
    rows: int
    columns: int
    row_step: int
    point_step: int

    def column(self, column: Column) -> NDArray:
        """(N,) view or copy of one field of all points, row by row."""
        values = np.ndarray(
            (self.rows, self.columns),
            column.dtype,
            self.payload,  # type: ignore[arg-type]
            self.begin + column.offset,
            (self.row_step, self.point_step),
        )
        return values.reshape(-1)


def check_block(topic: str, block: Block, size: int, fields: Mapping[str, Column]) -> None:
    """Raise DecodeError unless all points lie in `size` bytes of data, and the fields quadlog reads in a point."""
    if block.rows == 0 or block.columns == 0:
        return
    if block.point_step == 0 or (block.rows > 1 and block.row_step < block.columns * block.point_step):
        raise DecodeError(
            topic, f"point_step {block.point_step} and row_step {block.row_step} do not fit {block.columns} columns"
        )
    needed = (block.rows - 1) * block.row_step + block.columns * block.point_step
    if needed > size:
        raise DecodeError(
            topic,
            f"{block.rows} x {block.columns} points of {block.point_step} bytes need {needed} bytes, data has {size}",
        )
    for name, column in fields.items():
        read = name in ("x", "y", "z", *RING_FIELDS) or TIME_NAME.fullmatch(name)
        if read and column.offset + column.dtype.itemsize > block.point_step:
            raise DecodeError(topic, f"field {name} lies outside the point ({block.point_step} bytes)")


def cloud_from_block(
    topic: str, block: Block, fields: Mapping[str, Column], stamp_ns: int | None, frame_id: str, points: bool = True
) -> PointCloud:
    """The PointCloud of a checked block; ring only where a field gives plausible ones.

    points: False for a look at the stamp. Raises DecodeError without coordinates.
    """
    size = block.rows * block.columns
    missing = [name for name in "xyz" if name not in fields]
    if size and missing:
        listed = ", ".join(fields) or "none"
        raise DecodeError(topic, f"cloud without {', '.join(missing)}; its fields: {listed}")
    if not size or not points:
        return PointCloud(stamp_ns, frame_id, np.empty((0, 3), np.float32))
    ring_name = next((name for name in fields if name in RING_FIELDS), None)
    return PointCloud(
        stamp_ns,
        frame_id,
        _coordinates(block, fields),
        _rings(block.column(fields[ring_name])) if ring_name else None,
        time_fields={name: block.column(fields[name]) for name in fields if TIME_NAME.fullmatch(name)},
    )


Warn = Callable[[str], object]


def _coordinates(block: Block, fields: Mapping[str, Column]) -> NDArray[np.float32]:
    """(N, 3): a view of the payload where the coordinates lie side by side in it, else a copy."""
    x, y, z = (fields[name] for name in "xyz")
    native = x.dtype == y.dtype == z.dtype == np.float32
    in_a_row = block.rows == 1 or block.row_step == block.columns * block.point_step
    if native and in_a_row and z.offset - y.offset == y.offset - x.offset > 0:
        shape, strides = (block.rows * block.columns, 3), (block.point_step, y.offset - x.offset)
        return np.ndarray(shape, np.float32, block.payload, block.begin + x.offset, strides)  # type: ignore[arg-type]
    xyz_m = np.empty((3, block.rows * block.columns), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # beyond float32 is infinity, which is no valid point
        for axis, name in enumerate("xyz"):
            xyz_m[axis] = block.column(fields[name])
    return xyz_m.T


def _rings(values: NDArray) -> NDArray[np.uint16] | None:
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        return None
    if values.dtype != np.uint8 and values.dtype != np.uint16 and (values.min() < 0 or values.max() > 0xFFFF):
        return None
    return values.astype(np.uint16, copy=False)


POINT_BYTES = 19  # offset_time, x, y, z, reflectivity, tag, line
CDR_STRIDE = 20  # each point starts on a multiple of its first field's four bytes


def decode_livox(
    payload: Payload, topic: str, encoding: str, points: bool = True, warn: Warn = lambda _: None
) -> PointCloud:
    """One CustomMsg, whose line becomes ring; its size is checked before anything is allocated."""
    reader = PayloadReader(payload, encoding, topic)
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
    block = Block(payload, begin, count, 1, stride, POINT_BYTES)
    fields = {
        "offset_time": Column(0, np.dtype(reader.order + "u4")),
        "x": Column(4, np.dtype(reader.order + "f4")),
        "y": Column(8, np.dtype(reader.order + "f4")),
        "z": Column(12, np.dtype(reader.order + "f4")),
        "line": Column(18, np.dtype("u1")),
    }
    check_block(topic, block, size, fields)
    # Offsets count from timebase, which some drivers set apart from the header's stamp.
    cloud = cloud_from_block(topic, block, fields, header.stamp_ns, header.frame_id, points)
    zero_ns = timebase_ns - (cloud.stamp_ns or 0)
    if timebase_ns and abs(zero_ns) > LARGEST_SHIFT_NS:
        note = f"{topic}: timebase is more than a second off header.stamp; times of points count from the stamp"
        warn(note)
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

    def __init__(self, topic: str, encoding: str, points: bool = True, warn: Warn = lambda _: None) -> None:
        self.topic, self.encoding, self.points, self.warn = topic, encoding, points, warn
        self.known: tuple[int, int, bytes, Layout] | None = None

    def __call__(self, payload: Payload) -> PointCloud:
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
        block = Block(payload, begin, rows, columns, row_step, point_step)
        layout = _columns(fields, order)
        check_block(self.topic, block, size, layout)
        cloud = cloud_from_block(self.topic, block, layout, *header, self.points)
        if _absurd_share(cloud.xyz_m) >= LEAST_ABSURD:
            swapped = cloud_from_block(self.topic, block, _columns(fields, other), *header)
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


def _columns(fields: Layout, order: str) -> dict[str, Column]:
    return {name: Column(offset, np.dtype(order + DATATYPES[kind - 1])) for name, (offset, kind) in fields.items()}


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
