"""Walking an MCAP file from its first byte: what the index knows is skipped, everything else is found.

With a complete index this costs a few reads and finds messages outside chunks.
Without one it is the recovery: every chunk is read, checked and counted.
"""

from __future__ import annotations

import re
from bisect import bisect_right

from quadlog.recordings.containers import mcap_records as mcap
from quadlog.recordings.containers.bounded_reader import MAX_TIME_NS, Cursor, Damaged, read_at
from quadlog.recordings.containers.chunks import LostPiece, Piece, Scan
from quadlog.recordings.containers.container import Loss
from quadlog.recordings.containers.mcap_records import ChunkIndex, McapChannel, Schema
from quadlog.recordings.formatting import several
from quadlog.storage.byte_ranges import ByteSource

_HEAD_BYTES = 128
_DATA_END_BYTES = 4
_BEHIND_CHUNKS = (mcap.CHUNK, mcap.MESSAGE_INDEX, mcap.ATTACHMENT, mcap.METADATA, mcap.DATA_END)
_CUT_OFF = "the file is cut off here, or holds no records from here on"


class McapScan(Scan):
    """The pieces of a file's data section in file order, and the definitions found on the way.

    known are the chunks that an index describes. ended_at is the offset of
    the data section's end mark, None when there is none.
    """

    _chunk_mark = re.compile(rb"\x06(?=.{7}\0.{28}(?:\0{4}|\x03\0{3}lz4|\x04\0{3}zstd))", re.DOTALL)

    def __init__(self, file: ByteSource, size: int, known: list[ChunkIndex]) -> None:
        super().__init__(file, size, len(mcap.MAGIC))
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, McapChannel] = {}
        self.ended_at: int | None = None
        self.data_crc = 0
        self._known = {chunk.offset: chunk for chunk in known}
        self._offsets = sorted(self._known)
        self._lost_records: dict[tuple[str, str], tuple[int, str]] = {}
        self._walk()
        self._report_lost_records()

    def _walk(self) -> None:
        position = len(mcap.MAGIC)
        while self.ended_at is None:
            try:
                following = self._step(position)
                overrun = self._next_known(position)
                if overrun is not None and following > overrun:
                    raise Damaged("a record overlaps a chunk of the index")
                position = following
            except Damaged as damage:
                resume = self._next_known(position)
                if resume is not None:
                    self._close_loose()
                    self._lose_stretch(position, resume, damage)
                elif (resume := self._resync(position, damage)) is None:
                    return
                # The end mark may have been the damaged byte itself.
                self.ended_at = None
                position = resume
        self._close_loose()

    def _step(self, position: int) -> int:
        """Takes in the record at position and returns where the next one starts."""
        chunk = self._known.get(position)
        if chunk is not None:
            return self._take_indexed(chunk)
        frame = read_at(self._file, position, mcap.FRAME.size)
        opcode, length = mcap.FRAME.unpack(frame)
        begin = position + mcap.FRAME.size
        end = begin + length
        if opcode == mcap.CHUNK:
            self._close_loose()
            end = self._chunk_end(position, begin, end)
            self._take_chunk(position, begin, end)
            return end
        if opcode == 0 or end > self._size:
            raise Damaged(_CUT_OFF)
        if opcode == mcap.MESSAGE:
            self._take_message(position, begin, end)
        elif opcode in (mcap.SCHEMA, mcap.CHANNEL):
            try:
                self._define(opcode, memoryview(read_at(self._file, begin, length)))
            except Damaged as damage:
                self._lose_record(damage.cause, "message definition", damage.reason, position)
        elif opcode == mcap.DATA_END and length == _DATA_END_BYTES:
            self.data_crc = Cursor(read_at(self._file, begin, length)).u32()
            self.ended_at = position
            if self._next_known(position) is not None:
                raise Damaged("the data section's end mark stands before its last chunk")
        elif opcode == mcap.FOOTER:
            raise Damaged("the data section has no end mark")
        elif opcode == mcap.DATA_END or (not self._known and self._begin_of(position) is not None):
            raise Damaged("the kind of a record is damaged")
        return end

    def _take_indexed(self, chunk: ChunkIndex) -> int:
        self._close_loose()
        end = chunk.offset + max(chunk.length, 1) + chunk.message_index_length
        # Pieces never overlap, so no index can make quadlog read a byte twice.
        if end > (self._next_known(chunk.offset) or self._size):
            raise Damaged("the index gives a chunk more room than there is")
        self._trusted = end
        start_ns, end_ns = min(chunk.start_ns, MAX_TIME_NS), min(chunk.end_ns, MAX_TIME_NS)
        channels = chunk.channels or None
        self.pieces.append(
            Piece(chunk.offset, chunk.length, start_ns, end_ns, chunk.compression, channels, index_end=end)
        )
        return end

    def _chunk_end(self, position: int, begin: int, end: int) -> int:
        """Where a chunk's record ends: by its length, or where its data's length disagrees, by that which leads to the
        next record. Raises Damaged.
        """
        try:
            by_data = begin + mcap.chunk_length(self._head(begin))
        except Damaged:
            by_data = end
        found = [each for each in dict.fromkeys((end, by_data)) if end == by_data or self._leads_on(each)]
        if not found or found[0] > self._size:
            raise Damaged(_CUT_OFF if end == by_data else "a chunk's length is damaged")
        if found[0] != end:
            self._lose_record("damaged", "length of a chunk", "its end follows from its data", position)
        self._trusted = found[0]
        return found[0]

    def _head(self, begin: int) -> bytes:
        return read_at(self._file, begin, min(_HEAD_BYTES, max(self._size - begin, 0)))

    def _leads_on(self, end: int) -> bool:
        """Whether what may follow a chunk begins there."""
        if end >= self._size:
            return end == self._size
        head = self._head(end)
        if len(head) < mcap.FRAME.size:
            return False
        opcode, length = mcap.FRAME.unpack_from(head)
        return opcode in _BEHIND_CHUNKS and end + mcap.FRAME.size + length <= self._size

    def _begin_of(self, mark: int) -> int | None:
        _, length = mcap.FRAME.unpack_from(head := self._head(mark))
        try:
            whole = length == mcap.chunk_length(head[mcap.FRAME.size :])
        except Damaged:
            return None
        return mark if whole and mark + mcap.FRAME.size + length <= self._size else None

    def _next_known(self, position: int) -> int | None:
        place = bisect_right(self._offsets, position)
        return self._offsets[place] if place < len(self._offsets) else None

    def _define(self, opcode: int, content: memoryview) -> None:
        if opcode == mcap.SCHEMA:
            schema = mcap.read_schema(content)
            self._kept.keep((opcode, schema.number), len(content))
            self.schemas[schema.number] = schema
        elif opcode == mcap.CHANNEL:
            channel = mcap.read_channel(content)
            self.channels[channel.number] = channel

    def _take_message(self, position: int, begin: int, end: int) -> None:
        number, _, log_time_ns, _ = mcap.MESSAGE_HEAD.unpack(read_at(self._file, begin, mcap.MESSAGE_HEAD.size))
        if log_time_ns > MAX_TIME_NS:
            self._lose_record("damaged", "message", "its log time is beyond 63 bits", position)
            self._close_loose()
            return
        self._take_loose(position, end, log_time_ns, number)

    def _lose_record(self, cause: str, kind: str, why: str, position: int) -> None:
        count, first = self._lost_records.get((cause, kind), (0, f"at offset {position}: {why}"))
        self._lost_records[cause, kind] = count + 1, first

    def _report_lost_records(self) -> None:
        for (cause, kind), (count, first) in self._lost_records.items():
            detail = f"{several(count, kind)} lost; {'first' if count > 1 else 'it lies'} {first}"
            self.losses.append(Loss(cause, detail, count=count if kind == "message" else None))

    def _take_chunk(self, position: int, begin: int, end: int) -> None:
        start_ns = end_ns = 0
        try:
            content = memoryview(read_at(self._file, begin, end - begin))
            # Before the body is tried: a loss says from when to when.
            head = Cursor(content)
            start_ns, end_ns = min(head.u64(), MAX_TIME_NS), min(head.u64(), MAX_TIME_NS)
            body = mcap.read_chunk(content, self._file, position)
            entries = mcap.message_entries(body)
            for opcode, record in mcap.records(body.data):
                self._define(opcode, record)
        except Damaged as damage:
            piece = Piece(position, end - position, start_ns, end_ns)
            counts = message_index_counts(self._file, end, self._size)
            self.lost.append(LostPiece(piece, damage, None if counts is None else sum(counts.values())))
            return
        piece = entries.piece(position, end - position)
        self.pieces.append(piece)
        self.counts.update(piece.counts or {})


def message_index_counts(file: ByteSource, position: int, size: int) -> dict[int, int] | None:
    """Messages for each channel in the message index records from position on; None when there are none."""
    counts: dict[int, int] = {}
    try:
        while position < size:
            opcode, length = mcap.FRAME.unpack(read_at(file, position, mcap.FRAME.size))
            if opcode != mcap.MESSAGE_INDEX or position + length > size:
                break
            # Six bytes tell the channel and the size of the list; the list itself is not needed.
            number, list_bytes = mcap.MESSAGE_INDEX_HEAD.unpack(read_at(file, position + mcap.FRAME.size, 6))
            counts[number] = counts.get(number, 0) + list_bytes // 16
            position += mcap.FRAME.size + length
    except Damaged:
        return None
    return counts or None
