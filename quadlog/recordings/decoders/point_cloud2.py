"""sensor_msgs/PointCloud2, straight from the payload: ROS 1 and CDR of either byte order."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from quadlog.errors import DecodeError
from quadlog.messages import PointCloud
from quadlog.recordings.decoders.point_fields import Block, Column, MakeCloud, check_block, cloud_from_block
from quadlog.recordings.payload_reader import Payload, PayloadReader

# sensor_msgs/PointField datatypes 1 to 8.
DATATYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
MOST_FIELDS = 256


Layout = dict[str, tuple[int, int]]  # name -> (offset, datatype)


def point_cloud2_decoder(
    topic: str, encoding: str, make_cloud: MakeCloud = cloud_from_block
) -> Callable[[Payload], PointCloud]:
    """A decoder of payloads encoded as ``ros1`` or ``cdr``; it raises DecodeError for one that is not whole."""
    return _PointCloud2Decoder(topic, encoding, make_cloud)


class _PointCloud2Decoder:
    """Remembers the last field list, byte for byte: the next message nearly always has the same one."""

    def __init__(self, topic: str, encoding: str, make_cloud: MakeCloud) -> None:
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
