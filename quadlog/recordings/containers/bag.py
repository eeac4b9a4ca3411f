"""A ROS 1 bag (format 2.0, wiki.ros.org/Bags/Format/2.0): its records, its index, and how both are recovered where
the file is damaged.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from quadlog.errors import NothingReadable
from quadlog.recordings.containers.bounded_reader import (
    MAX_INDEX_BYTES,
    MAX_TIME_NS,
    Cursor,
    Damaged,
    name_of,
    read_at,
    read_each_at,
)
from quadlog.recordings.containers.chunked_reader import ChunkedReader
from quadlog.recordings.containers.chunks import (
    Body,
    Contents,
    Entries,
    EntryList,
    Listed,
    LostPiece,
    Piece,
    PieceFormat,
    Scan,
    losses_of,
    span_of,
)
from quadlog.recordings.containers.compression import Unpacked, decompress
from quadlog.recordings.containers.container import Channel, Loss, shared_channels
from quadlog.recordings.formatting import ros2_type_name
from quadlog.storage.byte_ranges import ByteSource

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
_MAX_HEADER_BYTES = 1 << 20
_BEHIND_CHUNKS = (INDEX, CHUNK, CHUNK_INFO, CONNECTION)
_MOST_HEADER_BYTES = 128
"""Of a chunk's or an index's record, which has three or four short fields."""
_TOO_LONG = "a record reaches beyond the end of the file"
HEAD_BYTES = 512
_U32 = struct.Struct("<I")
_TIME = struct.Struct("<II")
_NUMBER_BYTES = {b"op": 1, b"index_pos": 8, b"chunk_pos": 8} | dict.fromkeys(
    (b"conn", b"ver", b"count", b"size", b"conn_count", b"chunk_count"), 4
)
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


def read_frame(file: ByteSource, position: int, size: int = MAX_TIME_NS) -> Frame:
    """The record at position, without its data, that ends before size. Raises Damaged where there is none."""
    (length,) = _U32.unpack(read_at(file, position, 4))
    return parse_frame(read_at(file, position, length + 8, _MAX_HEADER_BYTES), position, size)


def parse_frame(head: bytes, position: int, size: int) -> Frame:
    """The same from its first bytes, which must hold the header. size: of the file. Raises Damaged."""
    cursor = Cursor(head)
    fields = read_fields(cursor.take(cursor.u32()))
    data_length = cursor.u32()
    data_offset = position + cursor.position
    if data_offset + data_length > size:
        raise Damaged(_TOO_LONG)
    return Frame(number(fields, b"op"), fields, data_offset, data_length)


def records(data: memoryview) -> Iterator[tuple[memoryview, int, int]]:
    """Header and the range of the data of each record in a buffer of whole records. Raises Damaged."""
    cursor = Cursor(data)
    while cursor:
        header = cursor.take(cursor.u32())
        length = cursor.u32()
        begin = cursor.position
        cursor.take(length)
        yield header, begin, begin + length


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


def number(fields: Fields, name: bytes) -> int:
    """The field of this name, a whole number of the size that the format gives it. Raises Damaged."""
    return int.from_bytes(_value(fields, name, _NUMBER_BYTES[name]), "little")


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
        number(header, b"conn"), text(header, b"topic"), type_name, definition, bytes(_value(fields, b"md5sum"))
    )


def read_chunk_info(header: Fields, data: memoryview) -> tuple[int, int, int, dict[int, int]]:
    """Offset, start and end (ns), and messages for each connection of a chunk. Raises Damaged."""
    if number(header, b"ver") != 1:
        raise Damaged(f"a chunk index of version {number(header, b'ver')} is unknown")
    pairs = number(header, b"count")
    if len(data) != 8 * pairs:
        raise Damaged(f"a chunk index names {pairs} connections in {len(data)} bytes")
    cursor, counts = Cursor(data), {}
    for _ in range(pairs):
        connection = cursor.u32()
        counts[connection] = cursor.u32()
    if len(counts) != pairs:
        raise Damaged("a chunk index names a connection twice")
    return number(header, b"chunk_pos"), time_ns(header, b"start_time"), time_ns(header, b"end_time"), counts


def chunk_of(frame: Frame) -> Frame:
    """The record, which must be a chunk. Raises Damaged."""
    if frame.op != CHUNK:
        raise Damaged("the index names a chunk where there is no chunk")
    return frame


def read_chunk(file: ByteSource, frame: Frame) -> Body:
    """A chunk's decompressed records. Raises Damaged."""
    data, offset = memoryview(read_at(file, frame.data_offset, frame.data_length)), frame.data_offset
    size = number(frame.fields, b"size")
    return Body(decompress(text(frame.fields, b"compression"), data, size, file, offset), len(data), file, offset)


def list_messages(indexes: memoryview) -> Listed:
    """The messages of a chunk by the index records behind it. Raises Damaged."""
    runs: dict[int, memoryview] = {}
    for header, begin, end in records(indexes):
        fields = read_fields(header)
        if number(fields, b"op") == INDEX:
            connection = number(fields, b"conn")
            if number(fields, b"ver") != 1 or end - begin != number(fields, b"count") * _INDEX_ENTRY.itemsize:
                raise Damaged("a message index is damaged")
            if connection in runs:
                raise Damaged("the message index of a chunk names a connection twice")
            runs[connection] = indexes[begin:end]
    rows = np.frombuffer(b"".join(runs.values()), _INDEX_ENTRY)
    t_ns = rows["seconds"].astype(np.int64) * 10**9 + rows["nanoseconds"]
    counts = {connection: len(run) // _INDEX_ENTRY.itemsize for connection, run in runs.items()}
    return Listed(counts, t_ns, rows["offset"].astype(np.int64))


def read_messages(body: Body) -> tuple[Entries, list[Connection]]:
    """The messages and the connections of a body of whole records, in file order. Raises Damaged.

    A header that differs from an earlier message's in its time alone is not taken apart again.
    """
    found, connections, at = EntryList(body), list[Connection](), 0
    known: dict[tuple[bytes, bytes], int] = {}
    for header, begin, end in records(body.data):
        found.count_record()
        head = header.tobytes()
        connection = known.get((head[:at], head[at + 8 :]))
        if connection is None:
            fields = read_fields(header)
            op = number(fields, b"op")
            if op == CONNECTION:
                connections.append(read_connection(fields, body.data[begin:end]))
                continue
            if op != MESSAGE:
                raise Damaged(f"it holds a record of kind {op}, which may have been a message")
            connection, t_ns = number(fields, b"conn"), time_ns(fields, b"time")
            if head.count(b"time=") == 1:
                at = head.index(b"time=") + 5
                known[head[:at], head[at + 8 :]] = connection
        else:
            t_ns = time_ns({b"time": header[at : at + 8]}, b"time")
        found.add(t_ns, begin, end, connection)
    return found.entries(), connections


def _value(fields: Fields, name: bytes, length: int | None = None) -> memoryview:
    value = fields.get(name)
    if value is None or (length is not None and len(value) != length):
        raise Damaged(f"a record lacks its field {name.decode()}")
    return value


class BagScan(Scan):
    """The pieces, connections and counts found by reading the whole bag, and what of it could not be read.

    Messages that lie outside chunks (the last, unfinished chunk of an
    `.active` bag) are found too.
    """

    _chunk_mark = re.compile(rb"\x04\0{3}op=\x05")
    _end_mark = re.compile(rb"\x04\0{3}op=[\x04\x05]")

    def __init__(self, file: ByteSource, size: int) -> None:
        super().__init__(file, size, len(MAGIC))
        self.connections: dict[int, Connection] = {}
        self._walk()

    def _walk(self) -> None:
        position = len(MAGIC)
        while position < self._size:
            try:
                position = self._step(position)
            except Damaged as damage:
                resume = self._resync(position, damage)
                if resume is None:
                    return
                position = resume
        self._close_loose()

    def _step(self, position: int) -> int:
        frame = read_frame(self._file, position)
        if frame.op == CHUNK:
            self._close_loose()
            frame = self._to_its_end(frame)
            self._trusted = frame.end
            self._take_chunk(position, frame)
            return frame.end
        if frame.end > self._size:
            raise Damaged(_TOO_LONG)
        if frame.op == MESSAGE:
            t_ns = time_ns(frame.fields, b"time")
            self._take_loose(position, frame.end, t_ns, number(frame.fields, b"conn"))
            return frame.end
        self._close_loose()
        if frame.op == CONNECTION:
            data = memoryview(read_at(self._file, frame.data_offset, frame.data_length))
            self._connect(read_connection(frame.fields, data))
        elif frame.op not in (BAG_HEADER, INDEX, CHUNK_INFO):
            raise Damaged("there are no records from here on")
        return frame.end

    def _to_its_end(self, frame: Frame) -> Frame:
        """A chunk up to the next record that only stands outside chunks, if its own length does not lead to one.

        Raises Damaged.
        """
        # A chunk that the recorder had not yet closed has no length: its messages follow as records of their own.
        if frame.data_length == 0 or self._leads_on(frame.end):
            return frame
        end = self._find(self._end_mark, frame.data_offset)
        if end is None:
            if frame.end > self._size:
                raise Damaged(_TOO_LONG)
            return frame
        return replace(frame, data_length=end - frame.data_offset)

    def _leads_on(self, end: int) -> bool:
        try:
            return end == self._size or read_frame(self._file, end, self._size).op in _BEHIND_CHUNKS
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

    def _take_chunk(self, position: int, frame: Frame) -> None:
        try:
            entries, connections = read_messages(read_chunk(self._file, frame))
            for connection in connections:
                self._connect(connection)
        except Damaged as damage:
            # It lies between the last message before it and an end that nothing says.
            last_ns = max((piece.end_ns for piece in self.pieces), default=0)
            self.lost.append(LostPiece(Piece(position, frame.end - position, last_ns, last_ns), damage, None))
            return
        if len(entries):
            piece = entries.piece(position, frame.end - position)
            self.pieces.append(piece)
            self.counts.update(piece.counts or {})

    def _connect(self, connection: Connection) -> None:
        self._kept.keep(connection.number, len(connection.definition))
        self.connections[connection.number] = connection


def read_bag(path: Path, file: ByteSource) -> ChunkedReader:
    """The bag in these bytes, which are the reader's from here on; path is its name.

    Raises NothingReadable when it is encrypted, or damaged without a readable message.
    """
    contents = _contents(path, file, file.size)
    serious = [loss for loss in contents.losses if loss.cause != "index"]
    if not contents.pieces and serious:
        raise NothingReadable(path, serious[-1].detail)
    return ChunkedReader(path, contents, BagFormat(file), file)


class BagFormat(PieceFormat):
    """How a piece of a bag is read."""

    def __init__(self, file: ByteSource) -> None:
        super().__init__(file)
        self._unpacked = Unpacked()

    def load_chunk(self, piece: Piece, at_most: int | None) -> Body | None:
        frame = chunk_of(read_frame(self.file, piece.offset))
        if piece.length:  # found by a walk, which knows where it ends whatever the record says
            frame = replace(frame, data_length=piece.offset + piece.length - frame.data_offset)
        if at_most is not None and number(frame.fields, b"size") > at_most:
            return None
        if text(frame.fields, b"compression") != "bz2":
            return read_chunk(self.file, frame)
        data = self._unpacked.data(piece.offset, lambda: read_chunk(self.file, frame).data)
        return Body(data, frame.data_length, self.file, frame.data_offset)

    def entries(self, body: Body) -> Entries:
        return read_messages(body)[0]

    def listed(self, pieces: Sequence[Piece]) -> list[Listed]:
        """See PieceFormat. Chunk headers are read as well: only they say where a chunk ends and its index begins."""
        if any(not piece.index_end for piece in pieces):
            raise Damaged("the bag has no index")
        heads = [(each.offset, min(HEAD_BYTES, each.index_end - each.offset)) for each in pieces]
        chunks = [
            chunk_of(parse_frame(head, piece.offset, self.file.size))
            for head, piece in zip(read_each_at(self.file, heads), pieces, strict=True)
        ]
        spans = [(chunk.end, piece.index_end - chunk.end) for chunk, piece in zip(chunks, pieces, strict=True)]
        return [list_messages(memoryview(index)) for index in read_each_at(self.file, spans)]


def _contents(path: Path, file: ByteSource, size: int) -> Contents:
    try:
        connections, pieces = _read_index(path, file, size)
    except Damaged as damage:
        scan = BagScan(file, size)
        detail = f"{damage.reason}; everything was read from the first byte on instead"
        losses = [Loss("index", detail), *losses_of(scan.lost), *scan.losses]
        return _assemble(scan.connections.values(), scan.pieces, losses)
    return _assemble(connections, pieces, [])


def _assemble(connections: Iterable[Connection], pieces: list[Piece], losses: list[Loss]) -> Contents:
    declared: Counter[int] = Counter()
    for piece in pieces:
        declared.update(piece.counts or {})
    held = [piece for piece in pieces if not piece.is_empty]
    return Contents(held, _channels(connections, declared), declared, span_of(held), losses)


def _read_index(path: Path, file: ByteSource, size: int) -> tuple[list[Connection], list[Piece]]:
    """Connections and chunks as the bag's index has them. Raises Damaged when there is no whole index."""
    header = read_frame(file, len(MAGIC), size)
    if header.op != BAG_HEADER:
        raise Damaged("the bag's header is damaged")
    if bytes(header.fields.get(b"encryptor", b"")):
        raise NothingReadable(path, "the bag is encrypted; decrypt it first  (rosbag decrypt)")
    index_offset = number(header.fields, b"index_pos")
    if index_offset == 0:
        raise Damaged("the bag was never closed and has no index  (rosbag reindex writes one)")
    if index_offset > size:
        raise Damaged("the bag is cut off before its index")
    connections, pieces = [], []
    section = memoryview(read_at(file, index_offset, size - index_offset, MAX_INDEX_BYTES))
    for head, begin, end in records(section):
        fields = read_fields(head)
        op = number(fields, b"op")
        if op == CONNECTION:
            connections.append(read_connection(fields, section[begin:end]))
        elif op == CHUNK_INFO:
            offset, start_ns, end_ns, counts = read_chunk_info(fields, section[begin:end])
            pieces.append(Piece(offset, 0, start_ns, end_ns, "", frozenset(counts), counts))
    expected = number(header.fields, b"conn_count"), number(header.fields, b"chunk_count")
    distinct = {connection.number for connection in connections}, {piece.offset for piece in pieces}
    if expected != (len(distinct[0]), len(distinct[1])) or len(pieces) != len(distinct[1]):
        raise Damaged("the bag's index is not whole")
    unknown = {number for piece in pieces for number in piece.counts or {}} - distinct[0]
    if unknown:
        raise Damaged("the bag's index names connections that it does not have")
    pieces.sort(key=lambda piece: piece.offset)
    for piece in pieces:
        if piece.is_empty:
            body = read_chunk(file, chunk_of(read_frame(file, piece.offset, size)))
            if len(read_messages(body)[0]):
                raise Damaged("the bag's index calls a chunk empty that has messages")
    behind = [*(piece.offset for piece in pieces[1:]), index_offset]
    return connections, [replace(piece, index_end=end) for piece, end in zip(pieces, behind, strict=False)]


def _channels(connections: Iterable[Connection], counts: Mapping[int, int]) -> dict[int, Channel]:
    """Connection ids to Channels: publishers of one topic share one, unless they disagree on the type."""
    definition_of: dict[tuple[str, str, bytes], bytes] = {}
    identities = []
    for each in sorted(connections, key=lambda connection: connection.number):
        definition = definition_of.setdefault((each.topic, each.type_name, each.md5sum), each.definition)
        identities.append((each.number, (each.topic, each.type_name, "ros1", "ros1msg", definition)))
    return shared_channels(identities, lambda number: counts.get(number, 0))
