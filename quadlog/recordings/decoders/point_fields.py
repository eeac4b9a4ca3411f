"""Named number columns inside a block of packed points: how PointCloud2 and its relatives become arrays.

A layout says where each field lies in a point; `cloud_from_block` copies the
coordinates out of the payload in one strided read, without a Python loop.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import DecodeError
from quadlog.messages import PointCloud
from quadlog.recordings.decoders.point_times import TIME_FIELDS, point_times
from quadlog.recordings.payload_reader import Payload

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
        times=point_times(block.column(fields[time_name]), stamp_ns) if time_name else None,
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
