"""The records of a ROS 1 bag (format 2.0, wiki.ros.org/Bags/Format/2.0), from bytes to plain values."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from quadlog.recordings.bounded import Cursor, Damaged, name_of, read_at
from quadlog.recordings.compression import decompress
from quadlog.recordings.pieces import Body, Entries, EntryList, Listed
from quadlog.recordings.words import ros2_type_name
from quadlog.storage.byte_source import ByteSource

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
_MAX_HEADER_BYTES = 1 << 20
HEAD_BYTES = 512
_U32 = struct.Struct("<I")
_TIME = struct.Struct("<II")
_INDEX_ENTRY = np.dtype([("seconds", "<u4"), ("nanoseconds", "<u4"), ("offset", "<u4")])

Fields = dict[bytes, memoryview]


@dataclass(frozen=True, slots=True)
class Connection:
    """One publisher of a topic, with the message definition it used; number is its id in the bag."""

    number: int
    topic: str
    type_name: str
    definition: bytes
    md5sum: bytes


@dataclass(frozen=True, slots=True)
class Frame:
    """A record's header fields and where its data lies in the file."""

    op: int
    fields: Fields
    data_offset: int
    data_length: int

    @property
    def end(self) -> int:
        return self.data_offset + self.data_length


def read_frame(file: ByteSource, position: int, size: int) -> Frame:
    """The record at position, without its data. Raises Damaged where there is none."""
    (length,) = _U32.unpack(read_at(file, position, 4))
    return _frame(read_at(file, position, length + 8, _MAX_HEADER_BYTES), position, size)


def _frame(head: bytes, position: int, size: int) -> Frame:
    cursor = Cursor(head)
    fields = read_fields(cursor.take(cursor.u32()))
    data_length = cursor.u32()
    data_offset = position + cursor.position
    if data_offset + data_length > size:
        raise Damaged("a record reaches beyond the end of the file")
    return Frame(u8(fields, b"op"), fields, data_offset, data_length)


def records(data: memoryview) -> Iterator[tuple[Fields, int, int]]:
    """Header fields and the range of the data of each record in a buffer of whole records. Raises Damaged."""
    cursor = Cursor(data)
    while cursor:
        fields = read_fields(cursor.take(cursor.u32()))
        length = cursor.u32()
        begin = cursor.position
        cursor.take(length)
        yield fields, begin, begin + length


def read_fields(header: memoryview) -> Fields:
    """`name=value` pairs. Raises Damaged."""
    fields = {}
    position, size = 0, len(header)
    while position < size:
        if position + 4 > size:
            raise Damaged("a header field is cut short")
        (length,) = _U32.unpack_from(header, position)
        begin = position + 4
        position = begin + length
        if position > size:
            raise Damaged("a header field reaches beyond its record")
        name, separator, _ = bytes(header[begin : min(position, begin + 64)]).partition(b"=")
        if not separator:
            raise Damaged("a header field has no name")
        fields[name] = header[begin + len(name) + 1 : position]
    return fields


def u8(fields: Fields, name: bytes) -> int:
    return _number(fields, name, 1)


def u32(fields: Fields, name: bytes) -> int:
    return _number(fields, name, 4)


def u64(fields: Fields, name: bytes) -> int:
    return _number(fields, name, 8)


def time_ns(fields: Fields, name: bytes) -> int:
    seconds, nanoseconds = _TIME.unpack(_value(fields, name, 8))
    return seconds * 10**9 + nanoseconds


def text(fields: Fields, name: bytes) -> str:
    return name_of(_value(fields, name))


def read_connection(header: Fields, data: memoryview) -> Connection:
    fields = read_fields(data)
    definition = bytes(_value(fields, b"message_definition"))
    type_name = ros2_type_name(text(fields, b"type"))
    return Connection(
        u32(header, b"conn"), text(header, b"topic"), type_name, definition, bytes(_value(fields, b"md5sum"))
    )


def read_chunk_info(header: Fields, data: memoryview) -> tuple[int, int, int, dict[int, int]]:
    """Offset, start and end (ns), and messages for each connection of a chunk. Raises Damaged."""
    if u32(header, b"ver") != 1:
        raise Damaged(f"a chunk index of version {u32(header, b'ver')} is unknown")
    pairs = u32(header, b"count")
    if len(data) != 8 * pairs:
        raise Damaged(f"a chunk index names {pairs} connections in {len(data)} bytes")
    cursor, counts = Cursor(data), {}
    for _ in range(pairs):
        number = cursor.u32()
        counts[number] = cursor.u32()
    if len(counts) != pairs:
        raise Damaged("a chunk index names a connection twice")
    return u64(header, b"chunk_pos"), time_ns(header, b"start_time"), time_ns(header, b"end_time"), counts


def read_chunk_frame(file: ByteSource, position: int, size: int) -> Frame:
    """The chunk's record at position, without its data. Raises Damaged."""
    return _of_chunk(read_frame(file, position, size))


def chunk_frame(head: bytes, position: int, size: int) -> Frame:
    """The same from the chunk's first HEAD_BYTES, which hold the header of any that a recorder writes."""
    return _of_chunk(_frame(head, position, size))


def _of_chunk(frame: Frame) -> Frame:
    if frame.op != CHUNK:
        raise Damaged("where the index has a chunk there is none")
    return frame


def read_chunk(file: ByteSource, frame: Frame) -> Body:
    """A chunk's decompressed records. Raises Damaged."""
    data = memoryview(read_at(file, frame.data_offset, frame.data_length))
    return Body(decompress(text(frame.fields, b"compression"), data, chunk_size(frame)), len(data))


def chunk_size(frame: Frame) -> int:
    """How many bytes a chunk declares to hold. Raises Damaged."""
    return u32(frame.fields, b"size")


def list_messages(indexes: memoryview) -> Listed:
    """The messages of a chunk by the index records behind it. Raises Damaged."""
    runs: dict[int, memoryview] = {}
    for fields, begin, end in records(indexes):
        if u8(fields, b"op") == INDEX:
            number = u32(fields, b"conn")
            if u32(fields, b"ver") != 1 or end - begin != u32(fields, b"count") * _INDEX_ENTRY.itemsize:
                raise Damaged("a message index is damaged")
            if number in runs:
                raise Damaged("the message index of a chunk names a connection twice")
            runs[number] = indexes[begin:end]
    rows = np.frombuffer(b"".join(runs.values()), _INDEX_ENTRY)
    t_ns = rows["seconds"].astype(np.int64) * 10**9 + rows["nanoseconds"]
    counts = {number: len(run) // _INDEX_ENTRY.itemsize for number, run in runs.items()}
    return Listed(counts, t_ns, rows["offset"].astype(np.int64))


def message_entries(body: Body) -> Entries:
    """Every message among a body of whole records, in file order. Raises Damaged."""
    found = EntryList(body)
    for fields, begin, end in records(body.data):
        found.count_record()
        op = u8(fields, b"op")
        if op == MESSAGE:
            found.add(time_ns(fields, b"time"), begin, end, u32(fields, b"conn"))
        elif op != CONNECTION:
            raise Damaged(f"it holds a record of kind {op}, which may have been a message")
    return found.entries()


def _value(fields: Fields, name: bytes, length: int | None = None) -> memoryview:
    value = fields.get(name)
    if value is None or (length is not None and len(value) != length):
        raise Damaged(f"a record lacks its field {name.decode()}")
    return value


def _number(fields: Fields, name: bytes, length: int) -> int:
    return int.from_bytes(_value(fields, name, length), "little")
