"""The records of an MCAP file (mcap.dev/spec), from bytes to plain values."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from isal.isal_zlib import crc32

from quadlog.recordings.containers.bounded_reader import MAX_TIME_NS, Cursor, Damaged
from quadlog.recordings.containers.chunks import Body, Entries, EntryList, Listed
from quadlog.recordings.containers.compression import decompress
from quadlog.storage.byte_ranges import ByteSource

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
MESSAGE_INDEX, CHUNK_INDEX, ATTACHMENT, STATISTICS, METADATA, DATA_END = 0x07, 0x08, 0x09, 0x0B, 0x0C, 0x0F
FRAME = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")
STATISTICS_HEAD = struct.Struct("<QHIIIIQQ")
INDEX_HEAD = struct.Struct("<BQHI")
MESSAGE_INDEX_HEAD = struct.Struct("<HI")
CHUNK_PLACE = struct.Struct("<QQQQ")
MAP_ENTRY = struct.Struct("<HQ")


class Schema(NamedTuple):
    """A message definition; number is its id in the file."""

    number: int
    name: str
    encoding: str
    data: bytes


class McapChannel(NamedTuple):
    """A topic; schema is 0 where it has none."""

    number: int
    schema: int
    topic: str
    message_encoding: str


class ChunkIndex(NamedTuple):
    """Where a chunk lies and what it spans. channels is empty where no message index was written."""

    start_ns: int
    end_ns: int
    offset: int
    length: int
    channels: frozenset[int]
    message_index_length: int
    compression: str


class Statistics(NamedTuple):
    """How much there is, as the writer counted it."""

    messages: int
    schemas: int
    channels: int
    chunks: int
    start_ns: int
    end_ns: int
    channel_counts: dict[int, int]


def records(data: bytes | memoryview) -> Iterator[tuple[int, memoryview]]:
    """Opcode and content of each record in a buffer of whole records. Raises Damaged."""
    cursor = Cursor(data)
    while cursor:
        opcode, length = FRAME.unpack(cursor.take(FRAME.size))
        yield opcode, cursor.take(length)


def read_schema(content: memoryview) -> Schema:
    cursor = Cursor(content)
    return Schema(cursor.u16(), cursor.text(), cursor.text(), bytes(cursor.take(cursor.u32())))


def read_channel(content: memoryview) -> McapChannel:
    cursor = Cursor(content)
    return McapChannel(cursor.u16(), cursor.u16(), cursor.text(), cursor.text())


def read_chunk_index(content: memoryview) -> ChunkIndex:
    cursor = Cursor(content)
    start_ns, end_ns, offset, length = CHUNK_PLACE.unpack(cursor.take(CHUNK_PLACE.size))
    channels = frozenset(_map_u16_u64(cursor))
    return ChunkIndex(start_ns, end_ns, offset, length, channels, cursor.u64(), cursor.text())


def read_statistics(content: memoryview) -> Statistics:
    cursor = Cursor(content)
    *counts, start_ns, end_ns = STATISTICS_HEAD.unpack(cursor.take(STATISTICS_HEAD.size))
    messages, schemas, channels, _, _, chunks = counts  # without attachments and metadata: nothing quadlog reads
    return Statistics(messages, schemas, channels, chunks, start_ns, end_ns, _map_u16_u64(cursor))


def list_messages(indexes: memoryview) -> Listed:
    """The messages of a chunk by the message index records behind it. Raises Damaged."""
    runs: dict[int, memoryview] = {}
    position = 0
    while position < len(indexes):
        if position + INDEX_HEAD.size > len(indexes):
            raise Damaged("a message index is cut short")
        opcode, length, number, size = INDEX_HEAD.unpack_from(indexes, position)
        begin = position + INDEX_HEAD.size
        position += FRAME.size + length
        if opcode != MESSAGE_INDEX or size % 16 or begin + size > min(position, len(indexes)):
            raise Damaged("the index names a message index where there is none")
        if number in runs:
            raise Damaged("the message index of a chunk names a channel twice")
        runs[number] = indexes[begin : begin + size]
    rows = np.frombuffer(b"".join(runs.values()), "<u8").reshape(-1, 2)
    if rows.max(initial=0) > MAX_TIME_NS:
        raise Damaged("a log time or an offset in a message index does not fit into 63 bits")
    counts = {number: len(run) // 16 for number, run in runs.items()}
    return Listed(counts, rows[:, 0].astype(np.int64), rows[:, 1].astype(np.int64))


def chunk_size(content: memoryview) -> int:
    """How many bytes a chunk declares to hold. Raises Damaged."""
    return Cursor(content[16:]).u64()


def chunk_length(head: bytes) -> int:
    """How long the content of a chunk is by the length of its data; head: its first bytes. Raises Damaged."""
    cursor = Cursor(head)
    cursor.take(28)  # start, end, size and checksum
    cursor.text()
    length = cursor.u64()
    return cursor.position + length


def read_chunk(content: memoryview, file: ByteSource, offset: int) -> Body:
    """The decompressed records of a chunk of a file. Raises Damaged, cause `crc` for a wrong checksum.

    Its data end where they say, or where the content does, if one of the two lengths is damaged.
    """
    cursor = Cursor(content)
    cursor.take(16)  # start and end
    size, crc = cursor.u64(), cursor.u32()
    compression = cursor.text()
    length = cursor.u64()
    stored = content[cursor.position :]
    try:
        data = _checked(decompress(compression, stored[:length], size, file, offset), crc)
    except Damaged:
        if length == len(stored):
            raise
        data = _checked(decompress(compression, stored, size, file, offset), crc)
    return Body(data, len(content), file, offset)


def _checked(data: memoryview, crc: int) -> memoryview:
    if crc and crc32(data) != crc:
        raise Damaged("its checksum (CRC) does not match", "crc")
    return data


def message_entries(body: Body) -> Entries:
    """Every message among a body of whole records, in file order. Raises Damaged."""
    found = EntryList(body)
    data, position, size = body.data, 0, len(body.data)
    while position < size:
        found.count_record()
        if position + FRAME.size > size:
            raise Damaged("a record is cut short")
        opcode, length = FRAME.unpack_from(data, position)
        begin = position + FRAME.size
        position = begin + length
        if position > size:
            raise Damaged("a record reaches beyond its chunk")
        if opcode == MESSAGE:
            if length < MESSAGE_HEAD.size:
                raise Damaged("a message is cut short")
            number, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(data, begin)
            if log_time_ns > MAX_TIME_NS:
                raise Damaged(f"a log time of {log_time_ns} ns does not fit into 63 bits")
            found.add(log_time_ns, begin + MESSAGE_HEAD.size, position, number)
        elif opcode <= DATA_END and opcode not in (SCHEMA, CHANNEL):
            raise Damaged(f"it holds a record of kind {opcode}, which may have been a message")
    return found.entries()


def _map_u16_u64(cursor: Cursor) -> dict[int, int]:
    fields = cursor.take(cursor.u32())
    if len(fields) % MAP_ENTRY.size:
        raise Damaged("a map is cut short")
    return dict(MAP_ENTRY.iter_unpack(fields))
