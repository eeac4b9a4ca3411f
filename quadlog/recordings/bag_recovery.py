"""Walking a bag without an index (crashed, still `.active`, cut off) from its first byte."""

from __future__ import annotations

from collections import Counter

from quadlog.recordings import bag_records as bag
from quadlog.recordings.bag_records import Connection, Frame
from quadlog.recordings.bounded import Damaged, KeptDefinitions, read_at
from quadlog.recordings.container import Loss
from quadlog.recordings.pieces import LooseRun, LostPiece, Piece
from quadlog.recordings.words import instant, several
from quadlog.storage.byte_source import ByteSource


class BagScan:
    """The pieces, connections and counts found by reading the whole bag, and what of it could not be read.

    Messages that lie outside chunks (the last, unfinished chunk of an
    `.active` bag) are found too.
    """

    def __init__(self, file: ByteSource, size: int) -> None:
        self.pieces: list[Piece] = []
        self.connections: dict[int, Connection] = {}
        self.counts: Counter[int] = Counter()
        self.lost: list[LostPiece] = []
        self.losses: list[Loss] = []
        self._file, self._size = file, size
        self._loose = LooseRun()
        self._kept = KeptDefinitions()
        self._walk()

    def _walk(self) -> None:
        position = len(bag.MAGIC)
        while position < self._size:
            try:
                position = self._step(position)
            except Damaged as damage:
                self._close_loose()
                self._lose_rest(position, damage)
                return
        self._close_loose()

    def _step(self, position: int) -> int:
        frame = bag.read_frame(self._file, position, self._size)
        if frame.op == bag.MESSAGE:
            self._take_message(position, frame)
            return frame.end
        self._close_loose()
        if frame.op == bag.CHUNK:
            self._take_chunk(position, frame)
        elif frame.op == bag.CONNECTION:
            data = memoryview(read_at(self._file, frame.data_offset, frame.data_length))
            self._connect(bag.read_connection(frame.fields, data))
        elif frame.op not in (bag.BAG_HEADER, bag.INDEX, bag.CHUNK_INFO):
            raise Damaged("there are no records from here on")
        return frame.end

    def _take_chunk(self, position: int, frame: Frame) -> None:
        # A chunk that the recorder had not yet closed has no length: its messages follow as records of their own.
        try:
            body = bag.read_chunk(self._file, frame)
            entries = bag.message_entries(body)
            for fields, begin, stop in bag.records(body.data):
                if bag.u8(fields, b"op") == bag.CONNECTION:
                    self._connect(bag.read_connection(fields, body.data[begin:stop]))
        except Damaged as damage:
            self.lost.append(LostPiece(self._unread(position, frame), damage, None))
            return
        if len(entries):
            piece = entries.piece(position, frame.end - position)
            self.pieces.append(piece)
            self.counts.update(piece.counts or {})

    def _unread(self, position: int, frame: Frame) -> Piece:
        """A damaged chunk, between the last message before it and an end nobody knows."""
        last_ns = max((piece.end_ns for piece in self.pieces), default=0)
        return Piece(position, frame.end - position, last_ns, last_ns)

    def _take_message(self, position: int, frame: Frame) -> None:
        if not self._loose.continues_at(position, frame.end):
            self._close_loose()
        number, t_ns = bag.u32(frame.fields, b"conn"), bag.time_ns(frame.fields, b"time")
        self._loose.add(position, frame.end, t_ns, number)
        self.counts[number] += 1

    def _close_loose(self) -> None:
        if self._loose.counts:
            self.pieces.append(self._loose.piece())
        self._loose = LooseRun()

    def _connect(self, connection: Connection) -> None:
        self._kept.keep(connection.number, len(connection.definition))
        self.connections[connection.number] = connection

    def _lose_rest(self, position: int, damage: Damaged) -> None:
        last_ns = max((piece.end_ns for piece in self.pieces), default=None)
        until = "nothing before it" if last_ns is None else f"messages until {instant(last_ns)}"
        lost = several(self._size - position, "byte")
        self.losses.append(
            Loss("truncated", f"{lost} after offset {position} unreadable ({damage.reason}); read: {until}")
        )
