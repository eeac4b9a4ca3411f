"""What MCAP and ROS 1 bags have in common: a file of chunks, each read, checked and decompressed at once; and what is
lost of them.
"""

from __future__ import annotations

import re
from array import array
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Int
from quadlog.recordings.containers.bounded_reader import MAX_TIME_NS, Damaged, KeptDefinitions, read_at
from quadlog.recordings.containers.container import Channel, Loss
from quadlog.recordings.formatting import instant, several
from quadlog.storage.byte_ranges import ByteSource

_LEAST_BYTES = 8
_LOOSE_BYTES = 1 << 22
_BLOCK_BYTES, _MARK_BYTES = 1 << 20, 64


@dataclass(frozen=True, slots=True)
class Piece:
    """A stretch of the file that is read at once: a chunk, or a run of records outside chunks (loose).

    length is 0 where only the chunk itself has it. channel_ids and counts
    (messages for each channel id) are None where the index does not say.
    index_end: offset behind the message index, which follows the chunk; 0 where there is none.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    compression: str = ""
    channel_ids: frozenset[int] | None = None
    counts: Mapping[int, int] | None = None
    loose: bool = False
    index_end: int = 0

    @property
    def is_empty(self) -> bool:
        """Nothing in it, as far as the index says."""
        return self.counts is not None and not any(self.counts.values())

    def may_hold(self, wanted: Collection[int], start_ns: int | None, end_ns: int | None) -> bool:
        """Whether any message of the wanted channels with start_ns <= log time < end_ns can be in it."""
        if self.is_empty or (self.channel_ids is not None and self.channel_ids.isdisjoint(wanted)):
            return False
        return (start_ns is None or self.end_ns >= start_ns) and (end_ns is None or self.start_ns < end_ns)


def span_of(pieces: Sequence[Piece]) -> tuple[int, int] | None:
    """Log times of the first and the last message in pieces that are not empty."""
    held = [piece for piece in pieces if not piece.is_empty]
    return (min(piece.start_ns for piece in held), max(piece.end_ns for piece in held)) if held else None


start_of = attrgetter("start_ns")
"""Sort key of pieces: the order in which they are read."""


@dataclass(frozen=True, slots=True)
class Body:
    """A piece's records, decompressed, and how many bytes of the file they took, from an offset on."""

    data: memoryview
    stored_bytes: int
    file: ByteSource
    offset: int

    @property
    def worth_records(self) -> int:
        """How many records its size is worth: time and memory are spent in proportion to what was read.

        A message takes some bytes of the file, because its time and its sequence number change; those that take fewer
        count against the file's allowance.
        """
        return self.stored_bytes // _LEAST_BYTES


class EntryList:
    """Where the payloads of a body's messages lie, collected record by record. Raises Damaged if they are too many."""

    def __init__(self, body: Body) -> None:
        self._body = body
        self._spare = body.file.spare_records.left(body.offset)
        self._max_records = body.worth_records + self._spare
        self._records = 0
        # 28 bytes a message, where tuples would take 200.
        self._log_times_ns, self._begins, self._ends = array("q"), array("q"), array("q")
        self._channel_ids = array("I")

    def count_record(self) -> None:
        """One more record of any kind."""
        self._records += 1
        if self._records > self._max_records:
            self._body.file.spare_records.take(self._body.offset, self._spare)
            raise Damaged(f"it holds more than {self._max_records} records", "too-large")

    def add(self, log_time_ns: int, begin: int, end: int, channel_id: int) -> None:
        """A message's payload."""
        self._log_times_ns.append(log_time_ns)
        self._begins.append(begin)
        self._ends.append(end)
        self._channel_ids.append(channel_id)

    def entries(self) -> Entries:
        """What was collected."""
        self._body.file.spare_records.take(self._body.offset, self._records - self._body.worth_records)
        times_ns, begins, ends = (np.array(each, np.int64) for each in (self._log_times_ns, self._begins, self._ends))
        return Entries(times_ns, begins, ends, np.array(self._channel_ids, np.uint32))


class Listed(NamedTuple):
    """A piece's messages by its message index: N log times and offsets, channel after channel.

    counts: how many of the rows are each channel id's, in their order.
    """

    counts: dict[int, int]
    t_ns: Int
    offsets: Int


@dataclass(frozen=True, slots=True, eq=False)
class Entries:
    """Where the payloads of a body's messages lie, in file order: an array (N,) for each property."""

    log_times_ns: Int
    begins: Int
    ends: Int
    channel_ids: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.log_times_ns)

    def counts(self) -> dict[int, int]:
        """Messages for each channel id."""
        return dict(sorted(Counter(self.channel_ids.tolist()).items()))  # a chunk holds few: np.unique takes longer

    def listed(self) -> Listed:
        """The same as a message index would have them."""
        rows = np.argsort(self.channel_ids, kind="stable")
        return Listed(self.counts(), self.log_times_ns[rows], self.begins[rows])

    def piece(self, offset: int, length: int) -> Piece:
        """The piece at this place of the file that holds them."""
        counts = self.counts()
        start_ns, end_ns = (self.log_times_ns.min(), self.log_times_ns.max()) if len(self) else (0, 0)
        return Piece(offset, length, int(start_ns), int(end_ns), "", frozenset(counts), counts)

    def chosen(self, wanted: Collection[int], start_ns: int | None, end_ns: int | None) -> Entries:
        """Those of these channels with start_ns <= log time < end_ns, in order of log time."""
        keep = np.fromiter(map(frozenset(wanted).__contains__, self.channel_ids.tolist()), np.bool_, len(self))
        if start_ns is not None:
            keep &= self.log_times_ns >= min(start_ns, MAX_TIME_NS)
        if end_ns is not None and end_ns <= MAX_TIME_NS:
            keep &= self.log_times_ns < end_ns
        rows = np.flatnonzero(keep)
        times_ns = self.log_times_ns[rows]
        if np.any(times_ns[1:] < times_ns[:-1]):
            rows = rows[np.argsort(times_ns, kind="stable")]
        return Entries(self.log_times_ns[rows], self.begins[rows], self.ends[rows], self.channel_ids[rows])


class LooseRun:
    """Messages outside chunks that lie side by side, to be read as one piece."""

    def __init__(self) -> None:
        self.counts: Counter[int] = Counter()
        self._begin = self._end = self._start_ns = self._end_ns = 0

    def continues_at(self, position: int, end: int) -> bool:
        """Whether a message from position to end is the next one and there is room for it."""
        return position == self._end and end - self._begin <= _LOOSE_BYTES

    def add(self, position: int, end: int, log_time_ns: int, number: int) -> None:
        """A message whose record lies between these offsets."""
        if not self.counts:
            self._begin, self._start_ns, self._end_ns = position, log_time_ns, log_time_ns
        self._end = end
        self._start_ns, self._end_ns = min(self._start_ns, log_time_ns), max(self._end_ns, log_time_ns)
        self.counts[number] += 1

    def piece(self) -> Piece:
        """The piece of all that was added."""
        length, channels = self._end - self._begin, frozenset(self.counts)
        return Piece(self._begin, length, self._start_ns, self._end_ns, "", channels, dict(self.counts), loose=True)


class Scan:
    """What is found on the way through a file, and what of it could not be read.

    trusted: the offset behind the last chunk whose end is certain. Where records stop making sense behind it, the walk
    goes on at the next chunk.
    """

    _chunk_mark: re.Pattern[bytes]
    """Begins where every chunk has its mark, and reads no more than _MARK_BYTES."""

    def __init__(self, file: ByteSource, size: int, trusted: int) -> None:
        self._trusted = trusted
        self.pieces: list[Piece] = []
        self.counts: Counter[int] = Counter()
        self.lost: list[LostPiece] = []
        self.losses: list[Loss] = []
        self._file, self._size = file, size
        self._loose = LooseRun()
        self._kept = KeptDefinitions()

    def _take_loose(self, position: int, end: int, log_time_ns: int, number: int) -> None:
        """A message outside chunks, whose record lies between these offsets."""
        if not self._loose.continues_at(position, end):
            self._close_loose()
        self._loose.add(position, end, log_time_ns, number)
        self.counts[number] += 1

    def _close_loose(self) -> None:
        if self._loose.counts:
            self.pieces.append(self._loose.piece())
        self._loose = LooseRun()

    def _find(self, mark: re.Pattern[bytes], position: int) -> int | None:
        """Where the first record from position on begins that has a mark and is whole; None where there is none."""
        while position < self._size:
            try:
                block = read_at(self._file, position, min(_BLOCK_BYTES, self._size - position))
            except Damaged:
                return None
            for found in mark.finditer(block):
                begin = self._begin_of(position + found.start())
                if begin is not None:
                    return begin
            position += max(len(block) - _MARK_BYTES, 1) if position + len(block) < self._size else len(block)
        return None

    def _begin_of(self, mark: int) -> int | None:
        """Where the record begins whose mark lies there, None where there is no whole one."""
        raise NotImplementedError

    def _resync(self, position: int, damage: Damaged) -> int | None:
        """The next chunk after the last trusted one, where position makes no sense; what lies before is a loss."""
        self._close_loose()
        resume = self._find(self._chunk_mark, self._trusted)
        if resume == position:
            resume = self._find(self._chunk_mark, position + 1)
        if resume is not None and resume < position:  # a record before it has a wrong length
            while self.pieces and self.pieces[-1].offset + self.pieces[-1].length > resume:
                self.counts.subtract(self.pieces.pop().counts or {})
            position = self._trusted
        self._lose_stretch(position, self._size if resume is None else resume, damage)
        self._trusted = self._size if resume is None else resume + 1
        return resume

    def _lose_stretch(self, begin: int, end: int, damage: Damaged) -> None:
        last_ns = max((piece.end_ns for piece in self.pieces if not piece.is_empty), default=None)
        until = "nothing before it" if last_ns is None else f"messages until {instant(last_ns)}"
        cause = "truncated" if end == self._size else "damaged"
        lost = several(end - begin, "byte")
        self.losses.append(Loss(cause, f"{lost} after offset {begin} unreadable ({damage.reason}); read: {until}"))


class PieceFormat:
    """How the pieces of a file are read: what differs between the formats."""

    def __init__(self, file: ByteSource) -> None:
        self.file = file

    def load(self, piece: Piece, at_most: int | None = None) -> Body | None:
        """The piece's body, checked and decompressed; None for a chunk of more than at_most bytes. Raises Damaged."""
        return self.load_loose(piece) if piece.loose else self.load_chunk(piece, at_most)

    def load_loose(self, piece: Piece) -> Body:
        """The same of records outside chunks."""
        return Body(memoryview(read_at(self.file, piece.offset, piece.length)), piece.length, self.file, piece.offset)

    def load_chunk(self, piece: Piece, at_most: int | None) -> Body | None:
        """The same of a chunk."""
        raise NotImplementedError

    def entries(self, body: Body) -> Entries:
        """All messages of a body in file order. Raises Damaged."""
        raise NotImplementedError

    def listed(self, pieces: Sequence[Piece]) -> list[Listed]:
        """All messages of the pieces by their indexes, bodies unread except those of loose pieces. Raises Damaged."""
        raise NotImplementedError

    def counts(self, piece: Piece) -> Mapping[int, int] | None:
        """Messages for each channel id without reading the body, None where nothing says."""
        return piece.counts


@dataclass
class Contents:
    """What opening a file found: where the messages are, whose they are, and what is already known to be lost.

    declared holds, for each channel id, how many messages the file itself says it has.
    """

    pieces: list[Piece]
    channel_of: dict[int, Channel]
    declared: Mapping[int, int] | None
    span_ns: tuple[int, int] | None
    losses: list[Loss] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class LostPiece:
    """A piece that could not be read, why, and how many messages it held (None: nothing says)."""

    piece: Piece
    damage: Damaged
    messages: int | None

    def __post_init__(self) -> None:
        # A traceback would keep the frames of what failed, and with them the piece's body.
        self.damage.__traceback__ = self.damage.__context__ = None


JUMP_NS = 10**9
_DAY_NS = 86_400 * 10**9


def losses_of(lost: Iterable[LostPiece]) -> list[Loss]:
    """One Loss for each cause, in the order in which the first of its pieces lies in the file."""
    groups: dict[str, list[LostPiece]] = {}
    for each in sorted(lost, key=lambda each: each.piece.offset):
        groups.setdefault(each.damage.cause, []).append(each)
    return [_loss(cause, group) for cause, group in groups.items()]


def _loss(cause: str, group: list[LostPiece]) -> Loss:
    known = [each.messages for each in group if each.messages is not None]
    messages = several(sum(known), "message") if len(known) == len(group) else "an unknown number of messages"
    start_ns = min(each.piece.start_ns for each in group)
    end_ns = max(each.piece.end_ns for each in group)
    first = group[0]
    return Loss(
        cause,
        f"{several(len(group), 'chunk')} with {messages} between {instant(start_ns)} and {instant(end_ns)} lost; "
        f"{'first' if len(group) > 1 else 'it lies'} at offset {first.piece.offset}: {first.damage.reason}",
        count=sum(known) if len(known) == len(group) else None,
    )


def backward_jumps(pieces: Iterable[Piece]) -> list[int]:
    """By how many ns log time falls back, in file order, at each piece where that is more than a second."""
    jumps, latest_ns = [], 0
    for piece in sorted(pieces, key=lambda piece: piece.offset):
        if piece.is_empty or piece.end_ns == 0:
            continue
        if piece.start_ns < latest_ns - JUMP_NS:
            jumps.append(latest_ns - piece.start_ns)
        latest_ns = max(latest_ns, piece.end_ns)
    return jumps


def backward_jump_within(times_ns: Int) -> int:
    """The largest fall of log time (ns) below an earlier message's, 0 when it is at most a second."""
    largest_ns = int((np.maximum.accumulate(times_ns) - times_ns).max(initial=0))
    return largest_ns if largest_ns > JUMP_NS else 0


def jump_warning(jumps_ns: list[int]) -> list[str]:
    """No warning or one, over all jumps of the recording's clock."""
    if not jumps_ns:
        return []
    times = several(len(jumps_ns), "time")
    largest_s = max(jumps_ns) / 1e9
    return [f"log time goes back {times} in the file, by up to {largest_s:.3f} s; messages come in order of log time"]


def zero_time_warning(zero_count: int, end_ns: int) -> list[str]:
    """No warning or one: messages logged at time 0 by a clock that otherwise is nowhere near it."""
    if not zero_count or end_ns < _DAY_NS:
        return []
    return [f"{several(zero_count, 'message')} logged at time 0, the others until {instant(end_ns)}"]
