"""ROS 1 bags: read through their chunk index, recovered by a scan when there is none.

The chunk index alone is kept in memory, never the index of every message, so
memory does not grow with the bag. A bag has no checksums of its own: a flipped
byte in an uncompressed payload cannot be seen by any reader; what breaks a
record, its time or the count of a chunk is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from quadlog.errors import NothingReadable
from quadlog.recordings import bag_records as bag
from quadlog.recordings.bag_records import Connection
from quadlog.recordings.bag_recovery import BagScan
from quadlog.recordings.bounded import MAX_INDEX_BYTES, Damaged, read_at, read_each_at
from quadlog.recordings.chunked_reader import ChunkedReader
from quadlog.recordings.container import Channel, Loss
from quadlog.recordings.piece_losses import losses_of
from quadlog.recordings.pieces import Body, Contents, Entries, Listed, Piece
from quadlog.storage.byte_source import ByteSource, LocalBytes


def open_bag(path: Path) -> ChunkedReader:
    """Opens a ROS 1 bag. Raises NothingReadable when it is encrypted, or damaged without a message that can be had."""
    return read_bag(path, LocalBytes(path))


def read_bag(path: Path, file: ByteSource) -> ChunkedReader:
    """The bag in these bytes, which are the reader's from here on; path is its name. Raises as open_bag."""
    try:
        contents = _contents(path, file, file.size)
        serious = [loss for loss in contents.losses if loss.cause != "index"]
        if not contents.pieces and serious:
            raise NothingReadable(path, serious[-1].detail)
    except BaseException:
        file.close()
        raise
    return ChunkedReader(path, contents, BagFormat(file, file.size), file)


class BagFormat:
    """How a piece of a bag is read (PieceFormat)."""

    def __init__(self, file: ByteSource, size: int) -> None:
        self._file, self._size = file, size

    def load(self, piece: Piece, at_most: int | None = None) -> Body | None:
        if piece.loose:
            data = memoryview(read_at(self._file, piece.offset, piece.length))
            return Body(data, len(data))
        frame = bag.read_chunk_frame(self._file, piece.offset, self._size)
        if at_most is not None and bag.chunk_size(frame) > at_most:
            return None
        return bag.read_chunk(self._file, frame)

    def entries(self, body: Body) -> Entries:
        return bag.message_entries(body)

    def listed(self, pieces: Sequence[Piece]) -> list[Listed]:
        if any(not piece.index_end for piece in pieces):
            raise Damaged("the bag has no index")
        # Where a chunk ends only its header tells.
        heads = [(each.offset, min(bag.HEAD_BYTES, each.index_end - each.offset)) for each in pieces]
        chunks = [
            bag.chunk_frame(head, piece.offset, self._size)
            for head, piece in zip(read_each_at(self._file, heads), pieces, strict=True)
        ]
        spans = [(chunk.end, piece.index_end - chunk.end) for chunk, piece in zip(chunks, pieces, strict=True)]
        return [bag.list_messages(memoryview(index)) for index in read_each_at(self._file, spans)]

    def counts(self, piece: Piece) -> Mapping[int, int] | None:
        return piece.counts


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
    span = (min(piece.start_ns for piece in held), max(piece.end_ns for piece in held)) if held else None
    return Contents(held, _channels(connections, declared), declared, span, losses)


def _read_index(path: Path, file: ByteSource, size: int) -> tuple[list[Connection], list[Piece]]:
    """Connections and chunks as the bag's index has them. Raises Damaged when there is no whole index."""
    header = bag.read_frame(file, len(bag.MAGIC), size)
    if header.op != bag.BAG_HEADER:
        raise Damaged("the bag's header is damaged")
    if bytes(header.fields.get(b"encryptor", b"")):
        raise NothingReadable(path, "the bag is encrypted; decrypt it first  (rosbag decrypt)")
    index_offset = bag.u64(header.fields, b"index_pos")
    if index_offset == 0:
        raise Damaged("the bag was never closed and has no index  (rosbag reindex writes one)")
    if index_offset > size:
        raise Damaged("the bag is cut off before its index")
    connections, pieces = [], []
    section = memoryview(read_at(file, index_offset, size - index_offset, MAX_INDEX_BYTES))
    for fields, begin, end in bag.records(section):
        op = bag.u8(fields, b"op")
        if op == bag.CONNECTION:
            connections.append(bag.read_connection(fields, section[begin:end]))
        elif op == bag.CHUNK_INFO:
            offset, start_ns, end_ns, counts = bag.read_chunk_info(fields, section[begin:end])
            pieces.append(Piece(offset, 0, start_ns, end_ns, "", frozenset(counts), counts))
    expected = bag.u32(header.fields, b"conn_count"), bag.u32(header.fields, b"chunk_count")
    distinct = {connection.number for connection in connections}, {piece.offset for piece in pieces}
    if expected != (len(distinct[0]), len(distinct[1])) or len(pieces) != len(distinct[1]):
        raise Damaged("the bag's index is not whole")
    unknown = {number for piece in pieces for number in piece.counts or {}} - distinct[0]
    if unknown:
        raise Damaged("the bag's index names connections that it does not have")
    pieces.sort(key=lambda piece: piece.offset)
    for piece in pieces:
        if piece.is_empty:
            body = bag.read_chunk(file, bag.read_chunk_frame(file, piece.offset, size))
            if len(bag.message_entries(body)):
                raise Damaged("the bag's index calls a chunk empty that has messages")
    behind = [*(piece.offset for piece in pieces[1:]), index_offset]
    return connections, [replace(piece, index_end=end) for piece, end in zip(pieces, behind, strict=False)]


def _channels(connections: Iterable[Connection], counts: Mapping[int, int]) -> dict[int, Channel]:
    """Connection ids to Channels: publishers of one topic share one, unless they disagree on the type."""
    alike: dict[tuple[str, str, bytes], list[Connection]] = {}
    for each in sorted(connections, key=lambda connection: connection.number):
        alike.setdefault((each.topic, each.type_name, each.md5sum), []).append(each)
    merged = {}
    for (topic, type_name, _), group in alike.items():
        count = sum(counts.get(each.number, 0) for each in group)
        shared = Channel(topic, type_name, "ros1", "ros1msg", group[0].definition, count)
        merged.update(dict.fromkeys((each.number for each in group), shared))
    return merged
