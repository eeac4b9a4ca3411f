"""Walking an MCAP file from its first byte: what the index knows is skipped, everything else is found.

With a complete index this costs a few reads and finds messages outside chunks.
Without one it is the recovery: every chunk is read, checked and counted.
"""

from __future__ import annotations

from bisect import bisect_right

from quadlog.recordings.containers import mcap_records as mcap
from quadlog.recordings.containers.bounded_reader import MAX_TIME_NS, Cursor, Damaged, read_at
from quadlog.recordings.containers.chunks import LostPiece, Piece, Scan
from quadlog.recordings.containers.container import Loss
from quadlog.recordings.containers.mcap_records import ChunkIndex, McapChannel, Schema
from quadlog.recordings.formatting import several
from quadlog.storage.byte_ranges import ByteSource


class McapScan(Scan):
    """The pieces of a file's data section in file order, and the definitions found on the way.

    known are the chunks that an index describes. ended_at is the offset of
    the data section's end mark, None when there is none.
    """

    def __init__(self, file: ByteSource, size: int, known: list[ChunkIndex]) -> None:
        super().__init__(file, size)
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
                    raise Damaged("a record reaches into a chunk that the index knows")
                position = following
            except Damaged as damage:
                self._close_loose()
                resume = self._next_known(position)
                self._lose_stretch(position, self._size if resume is None else resume, damage)
                if resume is None:
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
        if opcode == 0 or end > self._size:
            raise Damaged("the file is cut off here, or holds no records from here on")
        if opcode == mcap.MESSAGE:
            self._take_message(position, begin, end)
        elif opcode in (mcap.SCHEMA, mcap.CHANNEL):
            try:
                self._define(opcode, memoryview(read_at(self._file, begin, length)))
            except Damaged as damage:
                self._lose_record(damage.cause, "message definition", damage.reason, position)
        elif opcode == mcap.CHUNK:
            self._close_loose()
            self._take_chunk(position, begin, end)
        elif opcode == mcap.DATA_END:
            self.data_crc = Cursor(read_at(self._file, begin, length)).u32()
            self.ended_at = position
            if self._next_known(position) is not None:
                raise Damaged("the data section's end mark stands before its last chunk")
        elif opcode == mcap.FOOTER:
            raise Damaged("the data section has no end mark")
        return end

    def _take_indexed(self, chunk: ChunkIndex) -> int:
        self._close_loose()
        end = chunk.offset + max(chunk.length, 1) + chunk.message_index_length
        # Pieces never overlap, so no index can make quadlog read a byte twice.
        if end > (self._next_known(chunk.offset) or self._size):
            raise Damaged("the index gives a chunk more room than there is")
        start_ns, end_ns = min(chunk.start_ns, MAX_TIME_NS), min(chunk.end_ns, MAX_TIME_NS)
        channels = chunk.channels or None
        self.pieces.append(
            Piece(chunk.offset, chunk.length, start_ns, end_ns, chunk.compression, channels, index_end=end)
        )
        return end

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
            body = mcap.read_chunk(content)
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
