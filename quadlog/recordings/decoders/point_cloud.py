"""Point clouds, of PointCloud2 and Livox messages, with the instant at which each point was measured.

Drivers disagree: seconds or nanoseconds, since the scan's stamp or since 1970.
A reading counts only if it puts every point within a second of the stamp.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import DecodeError
from quadlog.messages import NS_PER_S, PointCloud, PointTimes
from quadlog.recordings.decoders.payload import Payload, PayloadReader

TIME_FIELDS = (
    "t",
    "time",
    "timestamp",
    "time_stamp",
    "time_offset",
    "offset_time",
    "point_time",
    "point_time_offset",
    "timeoffset",
)

PLAUSIBLE_NS = 1_000_000_000


def point_times(values: NDArray, stamp_ns: int | None) -> PointTimes | None:
    """When points with these values (N,) were measured, or None where no unit makes the values plausible.

    Integers, of at most 32 bits in every format, are nanoseconds after the
    stamp (Ouster ``t``, Hesai, Livox). Floats are seconds (Velodyne ``time``,
    RoboSense ``timestamp``) or, as Livox has it, float nanoseconds, relative or
    of 1970.
    """
    values = np.ascontiguousarray(values)  # numpy searches and converts numbers side by side several times as fast
    low, high = float(values.min()), float(values.max())
    if values.dtype.kind != "f":
        plausible = values.dtype.itemsize >= 4 and _plausible(low, high)
        return PointTimes(values, int(values.min()), int(values.max())) if plausible else None
    if not (np.isfinite(low) and np.isfinite(high)):
        return _without_gaps(values, stamp_ns)
    for zero, scale, shift_ns in _readings(stamp_ns):
        first_ns, last_ns = (low - zero) * scale - shift_ns, (high - zero) * scale - shift_ns
        if _plausible(first_ns, last_ns):
            return PointTimes(values, round(first_ns), round(last_ns), zero, scale, shift_ns)
    return None


def _readings(stamp_ns: int | None) -> list[tuple[float, float, float]]:
    """(zero, scale, shift) of each way to read a float: offset_ns = (value - zero) * scale - shift."""
    readings = [(0.0, 1e9, 0.0)]
    if stamp_ns is not None:
        # Whole seconds are subtracted first, so that 1970-based doubles lose no more digits.
        seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
        readings += [(float(seconds), 1e9, float(nanoseconds)), (float(stamp_ns), 1.0, 0.0)]
    return readings


def _without_gaps(values: NDArray, stamp_ns: int | None) -> PointTimes | None:
    """Points without an echo often carry no time either; they get that of the first point that has one."""
    finite = np.isfinite(values)
    if not finite.any():
        return None
    return point_times(np.where(finite, values, values[finite][0]), stamp_ns)


def _plausible(low_ns: float, high_ns: float) -> bool:
    return low_ns >= -PLAUSIBLE_NS and high_ns <= PLAUSIBLE_NS


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
        read = name in ("x", "y", "z", *RING_FIELDS, *TIME_FIELDS)
        if read and column.offset + column.dtype.itemsize > block.point_step:
            raise DecodeError(topic, f"field {name} lies outside the point ({block.point_step} bytes)")


def cloud_from_block(
    topic: str, block: Block, fields: Mapping[str, Column], stamp_ns: int | None, frame_id: str
) -> PointCloud:
    """The PointCloud of a checked block; ring and offset_ns only where a field gives plausible ones."""
    cloud = checked_cloud(topic, block, fields, stamp_ns, frame_id)
    if block.rows * block.columns == 0:
        return cloud
    ring_name = next((name for name in fields if name in RING_FIELDS), None)
    time_name = next((name for name in fields if name in TIME_FIELDS), None)
    return PointCloud(
        stamp_ns,
        frame_id,
        _coordinates(block, fields),
        _rings(block.column(fields[ring_name])) if ring_name else None,
        times=point_times(np.ascontiguousarray(block.column(fields[time_name])), stamp_ns) if time_name else None,
    )


def checked_cloud(
    topic: str, block: Block, fields: Mapping[str, Column], stamp_ns: int | None, frame_id: str
) -> PointCloud:
    """The same without points: for a look at stamps. Raises DecodeError where cloud_from_block would."""
    missing = [name for name in "xyz" if name not in fields]
    if block.rows * block.columns and missing:
        listed = ", ".join(fields) or "none"
        raise DecodeError(topic, f"cloud without {', '.join(missing)}; its fields: {listed}")
    return PointCloud(stamp_ns, frame_id, np.empty((0, 3), np.float32))


MakeCloud = Callable[[str, Block, Mapping[str, Column], int | None, str], PointCloud]


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


def livox_decoder(
    topic: str, encoding: str, make_cloud: MakeCloud = cloud_from_block
) -> Callable[[Payload], PointCloud]:
    """A decoder of CustomMsg payloads; ``line`` becomes ring, ``offset_time`` offset_ns."""
    return partial(_decode_livox, encoding, topic, make_cloud)


def _decode_livox(encoding: str, topic: str, make_cloud: MakeCloud, payload: Payload) -> PointCloud:
    """One CustomMsg; the number of points is checked against the payload before anything is allocated."""
    reader = PayloadReader(payload, encoding, topic)
    header = reader.header()
    timebase_ns = reader.uint64()
    reader.uint32()  # point_num, which the sequence's own length repeats
    reader.skip(1 + 3)  # lidar_id, rsvd
    count = reader.uint32()
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
    cloud = make_cloud(topic, block, fields, header.stamp_ns, header.frame_id)
    return _relative_to_stamp(cloud, timebase_ns)


def _relative_to_stamp(cloud: PointCloud, timebase_ns: int) -> PointCloud:
    times = cloud.times
    if times is None or cloud.stamp_ns is None:
        return cloud
    shift_ns = timebase_ns - cloud.stamp_ns
    if shift_ns == 0 or abs(shift_ns) > PLAUSIBLE_NS:
        return cloud
    first_ns, last_ns = times.first_ns + shift_ns, times.last_ns + shift_ns
    return replace(cloud, times=replace(times, first_ns=first_ns, last_ns=last_ns, shift_ns=-shift_ns))


# sensor_msgs/PointField datatypes 1 to 8.
DATATYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
MOST_FIELDS = 256


Layout = dict[str, tuple[int, int]]  # name -> (offset, datatype)


class PointCloud2Decoder:
    """A decoder of payloads encoded as ``ros1`` or ``cdr``; it raises DecodeError for one that is not whole.

    The last field list is remembered, byte for byte: the next message nearly always has the same one.
    """

    def __init__(self, topic: str, encoding: str, make_cloud: MakeCloud = cloud_from_block) -> None:
        self.topic, self.encoding, self.make_cloud = topic, encoding, make_cloud
        self.known: tuple[int, int, bytes, Layout] | None = None

    def __call__(self, payload: Payload) -> PointCloud:
        """One PointCloud2; sizes are checked against the payload before anything is allocated."""
        reader = PayloadReader(payload, self.encoding, self.topic)
        header = reader.header()
        rows, columns = reader.uint32(), reader.uint32()
        fields = self._fields(reader)
        order = ">" if reader.uint8() else "<"
        point_step, row_step = reader.uint32(), reader.uint32()
        size = reader.uint32()
        begin = reader.skip(size)
        if rows <= 1 and row_step < columns * point_step:
            row_step = columns * point_step  # a single row needs none, and some drivers leave it at zero
        block = Block(payload, begin, rows, columns, row_step, point_step)
        layout = {
            name: Column(offset, np.dtype(order + DATATYPES[kind - 1])) for name, (offset, kind) in fields.items()
        }
        check_block(self.topic, block, size, layout)
        return self.make_cloud(self.topic, block, layout, header.stamp_ns, header.frame_id)

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


def _read_fields(reader: PayloadReader) -> Layout:
    """The field list at the cursor. The first element of an array field stands for it."""
    count = reader.uint32()
    if count > MOST_FIELDS:
        raise DecodeError(reader.topic, f"announces {count} point fields")
    fields: Layout = {}
    for _ in range(count):
        name, offset, datatype = reader.name(), reader.uint32(), reader.uint8()
        elements = reader.uint32()
        if not 1 <= datatype <= len(DATATYPES):
            raise DecodeError(reader.topic, f"field {name} has the unknown datatype {datatype}")
        if elements >= 1:
            fields.setdefault(name, (offset, datatype))
    return fields
