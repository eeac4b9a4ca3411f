"""A ROS 1 bag (format 2.0, wiki.ros.org/Bags/Format/2.0): its index, its chunks, and a walk where there is no index."""

from __future__ import annotations

import re
import struct
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from quadlog.errors import NothingReadable
from quadlog.recordings.containers.chunk_file import ROW, Chunk, Rows, listed_rows, name_of, read_at, read_each_at
from quadlog.recordings.containers.chunked import ChunkedReader
from quadlog.recordings.containers.compression import decompress
from quadlog.recordings.containers.container import MAX_INDEX_BYTES, MAX_TIME_NS, Damaged, Identity, Loss
from quadlog.recordings.formatting import ros2_type_name
from quadlog.storage.byte_source import Kept

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
_MAX_HEADER_BYTES = 1 << 20
_HEAD_BYTES = 512
_BEHIND_CHUNKS = (INDEX, CHUNK, CHUNK_INFO, CONNECTION)
_MOST_HEADER_BYTES = 128
"""Of a chunk's or an index's record, which has three or four short fields."""
_TOO_LONG = "a record reaches beyond the end of the file"
_U32 = struct.Struct("<I")
_INDEX_ENTRY = np.dtype([("seconds", "<u4"), ("nanoseconds", "<u4"), ("offset", "<u4")])


class _Fields(dict[bytes, bytes]):
    """The `name=value` pairs of a record's header. All of it raises Damaged."""

    def __init__(self, header: bytes | memoryview) -> None:
        position, size = 0, len(header)
        while position < size:
            begin = position + 4
            if begin > size:
                raise Damaged("a header field is cut short")
            position = begin + _U32.unpack_from(header, position)[0]
            if position > size:
                raise Damaged("a header field reaches beyond its record")
            name, separator, value = bytes(header[begin:position]).partition(b"=")
            if not separator:
                raise Damaged("a header field has no name")
            self[name] = value

    def value(self, name: bytes, length: int | None = None) -> bytes:
        value = self.get(name)
        if value is None or (length is not None and len(value) != length):
            raise Damaged(f"a record lacks its field {name.decode()}")
        return value

    def number(self, name: bytes, length: int = 4) -> int:
        return int.from_bytes(self.value(name, length), "little")

    def time_ns(self, name: bytes) -> int:
        time = self.number(name, 8)
        return (time & 0xFFFFFFFF) * 10**9 + (time >> 32)

    def text(self, name: bytes) -> str:
        return name_of(self.value(name))

    @property
    def op(self) -> int:
        return self.number(b"op", 1)


class _Frame(NamedTuple):
    """A record's header and where its data lies."""

    fields: _Fields
    begin: int
    end: int


def _frame(data: bytes | memoryview, position: int, offset: int, size: int) -> _Frame:
    """The record at this position of data, which holds its header and lies offset bytes further on in what ends at
    size. Raises Damaged.
    """
    try:
        at = position + 4 + _U32.unpack_from(data, position)[0]
        (length,) = _U32.unpack_from(data, at)
    except struct.error:
        raise Damaged("a record is cut short") from None
    begin = offset + at + 4
    if begin + length > size:
        raise Damaged(_TOO_LONG)
    return _Frame(_Fields(data[position + 4 : at]), begin, begin + length)


def _records(data: bytes | memoryview) -> Iterator[_Frame]:
    """Each record in a buffer of whole records. Raises Damaged."""
    position = 0
    while position < len(data):
        frame = _frame(data, position, 0, len(data))
        yield frame
        position = frame.end


class _Layout:
    """Where a message record has its connection and its time, and all else that its header consists of."""

    def __init__(self, head: bytes) -> None:
        conn, time = head.index(b"\x09\0\0\0conn=") + 9, head.index(b"\x0d\0\0\0time=") + 9
        self._size, self._conn_first = len(head), conn < time
        (first, kind, end), (second, other, behind) = sorted([(conn, "I", conn + 4), (time, "Q", time + 8)])
        self._struct = struct.Struct(f"<{first}s{kind}{second - end}s{other}{len(head) - 4 - behind}sI")
        self._fixed = self._struct.unpack(head)[:5:2]

    def row(self, data: memoryview, position: int) -> tuple[int, int, int, int] | None:
        """A ROW for the message at this position; None where the record there is laid out differently."""
        begin = position + self._size
        if begin > len(data):
            return None
        head, number, middle, time, tail, length = self._struct.unpack_from(data, position)
        if (head, middle, tail) != self._fixed:
            return None
        if not self._conn_first:
            number, time = time, number
        return (time & 0xFFFFFFFF) * 1_000_000_000 + (time >> 32), number, begin, begin + length


class _Connection(NamedTuple):
    """One publisher of a topic, with the message definition it used."""

    topic: str
    type_name: str
    definition: bytes
    md5sum: bytes


class BagReader(ChunkedReader):
    """Raises NothingReadable when the bag is encrypted, or damaged without a readable message.

    Messages that lie outside chunks (the last, unfinished chunk of an `.active` bag) are found too.
    """

    _mark = re.compile(rb"\x04\0{3}op=\x05")
    _end_mark = re.compile(rb"\x04\0{3}op=[\x04\x05]")

    def _open(self) -> None:
        self._connections: dict[int, _Connection] = {}
        self._unpacked = Kept()
        try:
            self._read_index()
        except Damaged as damage:
            self._connections, self._chunks = {}, []
            detail = f"{damage.reason}; everything was read from the first byte on instead"
            self._losses.append(Loss("index", detail))
            self._walk(len(MAGIC))
        self._chunks = [chunk for chunk in self._chunks if not chunk.is_empty]

    def _read_index(self) -> None:
        """Connections and chunks as the bag's index has them. Raises Damaged when there is no whole index."""
        size = self._file.size
        header = self._frame_at(len(MAGIC), size).fields
        if header.op != BAG_HEADER:
            raise Damaged("the bag's header is damaged")
        if header.get(b"encryptor"):
            raise NothingReadable(self.path, "the bag is encrypted; decrypt it first  (rosbag decrypt)")
        index_offset = header.number(b"index_pos", 8)
        if index_offset == 0:
            raise Damaged("the bag was never closed and has no index  (rosbag reindex writes one)")
        if index_offset > size:
            raise Damaged("the bag is cut off before its index")
        section = memoryview(read_at(self._file, index_offset, size - index_offset, MAX_INDEX_BYTES))
        for fields, begin, end in _records(section):
            if fields.op == CONNECTION:
                self._define(fields, section[begin:end])
            elif fields.op == CHUNK_INFO:
                self._chunks.append(_chunk_of(fields, section[begin:end]))
        self._chunks.sort(key=lambda chunk: chunk.offset)
        offsets = [chunk.offset for chunk in self._chunks]
        expected = header.number(b"conn_count"), header.number(b"chunk_count")
        if expected != (len(self._connections), len(set(offsets))) or len(offsets) != len(set(offsets)):
            raise Damaged("the bag's index is not whole")
        if {number for chunk in self._chunks for number in chunk.counts or ()} - self._connections.keys():
            raise Damaged("the bag's index names connections that it does not have")
        for chunk, behind in zip(self._chunks, [*offsets[1:], index_offset], strict=False):
            chunk.index_end = behind
            if chunk.is_empty and (body := self._body(chunk)) is not None and len(body.rows):
                raise Damaged("the bag's index calls a chunk empty that has messages")

    def _identities(self) -> Iterable[tuple[int, Identity]]:
        """Publishers of one topic share a channel, unless they disagree on the type."""
        definition_of: dict[tuple[str, str, bytes], bytes] = {}
        for number, each in sorted(self._connections.items()):
            definition = definition_of.setdefault((each.topic, each.type_name, each.md5sum), each.definition)
            yield number, (each.topic, each.type_name, "ros1", "ros1msg", definition)

    def _frame_at(self, position: int, size: int = MAX_TIME_NS) -> _Frame:
        """The record at this offset of the file, without its data, that ends before size. Raises Damaged."""
        head = read_at(self._file, position, min(_HEAD_BYTES, max(self._file.size - position, 4)))
        header_bytes = _U32.unpack_from(head)[0] + 8
        if header_bytes > len(head):
            head = read_at(self._file, position, header_bytes, _MAX_HEADER_BYTES)
        return _frame(head, 0, position, size)

    def _step(self, position: int) -> int | None:
        if position >= self._file.size:
            return None
        frame = self._frame_at(position)
        op = frame.fields.op
        if op == CHUNK:
            end = self._trusted = self._chunk_end(frame)
            # It lies between the last message before it and an end that nothing says, if it cannot be read.
            last_ns = max((chunk.end_ns for chunk in self._chunks), default=0)
            self._take_walked(Chunk(position, end - position, last_ns, last_ns))
            return end
        if frame.end > self._file.size:
            raise Damaged(_TOO_LONG)
        if op == MESSAGE:
            self._take_loose(position, frame.end, frame.fields.time_ns(b"time"), frame.fields.number(b"conn"))
        elif op == CONNECTION:
            self._define(frame.fields, memoryview(read_at(self._file, frame.begin, frame.end - frame.begin)))
        elif op not in (BAG_HEADER, INDEX, CHUNK_INFO):
            raise Damaged("there are no records from here on")
        return frame.end

    def _chunk_end(self, frame: _Frame) -> int:
        """Up to the next record that only stands outside chunks, if the chunk's own length does not lead to one.

        Raises Damaged.
        """
        # A chunk that the recorder had not yet closed has no length: its messages follow as records of their own.
        if frame.end == frame.begin or self._leads_on(frame.end):
            return frame.end
        end = self._find(self._end_mark, frame.begin)
        if end is None and frame.end > self._file.size:
            raise Damaged(_TOO_LONG)
        return frame.end if end is None else end

    def _leads_on(self, end: int) -> bool:
        try:
            return end == self._file.size or self._frame_at(end, self._file.size).fields.op in _BEHIND_CHUNKS
        except Damaged:
            return False

    def _begin_of(self, mark: int) -> int | None:
        low = max(mark - _MOST_HEADER_BYTES, 0)
        before = read_at(self._file, low, mark - low)
        for begin in range(mark - 4, low - 1, -1):
            (length,) = _U32.unpack_from(before, begin - low)
            if mark + 8 <= begin + 4 + length <= begin + _MOST_HEADER_BYTES and self._leads_on(begin):
                return begin
        return None

    def _define(self, kind: _Fields, content: memoryview) -> None:
        fields, number = _Fields(content), kind.number(b"conn")
        type_name, definition = ros2_type_name(fields.text(b"type")), fields.value(b"message_definition")
        self._account(number, len(definition))
        md5sum = fields.value(b"md5sum")
        self._connections[number] = _Connection(kind.text(b"topic"), type_name, definition, md5sum)

    def _load(self, chunk: Chunk, at_most: int | None) -> tuple[memoryview, int] | None:
        fields, begin, end = _chunk_record(self._frame_at(chunk.offset))
        if chunk.length:  # found by a walk, which knows where it ends whatever the record says
            end = chunk.end
        size, scheme = fields.number(b"size"), fields.text(b"compression")
        if at_most is not None and size > at_most:
            return None

        def unpack() -> memoryview:
            stored = memoryview(read_at(self._file, begin, end - begin))
            return decompress(scheme, stored, size, self._spare_bytes, begin)

        data = memoryview(self._unpacked.data(chunk.offset, unpack)) if scheme == "bz2" else unpack()
        return data, end - begin

    def _parse(self, data: memoryview, most: int) -> tuple[Rows, int, Sequence[tuple[_Fields, memoryview]]]:
        """See ChunkedReader. A recorder's messages have headers that differ in their values alone."""
        values, definitions, position, size = array("q"), list[tuple[_Fields, memoryview]](), 0, len(data)
        layout, records = None, 0
        while position < size and records <= most:
            records += 1
            row = layout and layout.row(data, position)
            if not row:
                fields, begin, end = _frame(data, position, 0, size)
                if fields.op == MESSAGE:
                    row = fields.time_ns(b"time"), fields.number(b"conn"), begin, end
                    layout = _Layout(bytes(data[position:begin]))
                elif fields.op == CONNECTION:
                    definitions.append((fields, data[begin:end]))
                    position = end
                    continue
                else:
                    raise Damaged(f"it holds a record of kind {fields.op}, which may have been a message")
            values.extend(row)
            position = row[3]
        if position > size:
            raise Damaged("a record reaches beyond its chunk")
        return np.frombuffer(values, ROW), records, definitions

    def _listed(self, chunks: Sequence[Chunk]) -> list[Rows]:
        """See ChunkedReader. Chunk headers are read as well: only they say where a chunk ends and its index begins."""
        size = self._file.size
        heads = read_each_at(self._file, [(each.offset, min(_HEAD_BYTES, size - each.offset)) for each in chunks])
        ends = [
            _chunk_record(_frame(head, 0, chunk.offset, size)).end for head, chunk in zip(heads, chunks, strict=True)
        ]
        spans = [(end, chunk.index_end - end) for end, chunk in zip(ends, chunks, strict=True)]
        return [_indexed_rows(index) for index in read_each_at(self._file, spans)]


def _chunk_record(frame: _Frame) -> _Frame:
    if frame.fields.op != CHUNK:
        raise Damaged("the index names a chunk where there is no chunk")
    return frame


def _chunk_of(header: _Fields, data: memoryview) -> Chunk:
    """A chunk as the bag's index has it. Raises Damaged."""
    if header.number(b"ver") != 1:
        raise Damaged(f"a chunk index of version {header.number(b'ver')} is unknown")
    pairs = header.number(b"count")
    if len(data) != 8 * pairs:
        raise Damaged(f"a chunk index names {pairs} connections in {len(data)} bytes")
    counts = Counter(dict(struct.iter_unpack("<II", data)))
    if len(counts) != pairs:
        raise Damaged("a chunk index names a connection twice")
    times_ns = header.time_ns(b"start_time"), header.time_ns(b"end_time")
    return Chunk(header.number(b"chunk_pos", 8), 0, *times_ns, counts=counts)


def _indexed_rows(index: bytes) -> Rows:
    """The messages of a chunk by the index records behind it. Raises Damaged."""
    runs = list[tuple[int, bytes]]()
    for fields, begin, end in _records(index):
        if fields.op == INDEX:
            number = fields.number(b"conn")
            if fields.number(b"ver") != 1 or end - begin != fields.number(b"count") * _INDEX_ENTRY.itemsize:
                raise Damaged("a message index is damaged")
            runs.append((number, index[begin:end]))
    rows, entries = listed_rows(runs, _INDEX_ENTRY)
    rows["t_ns"] = entries["seconds"].astype(np.int64) * 10**9 + entries["nanoseconds"]
    rows["begin"] = entries["offset"]
    return rows
