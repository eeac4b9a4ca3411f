"""What MCAP and ROS 1 bags have in common when they are opened: chunks that each are read, checked and decompressed at
once, and a walk over the records where no index describes them.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadlog.recordings.containers import compression
from quadlog.recordings.containers.container import (
    MAX_CHUNK_BYTES,
    MAX_DEFINITION_BYTES,
    MAX_INDEX_BYTES,
    MAX_NAME_BYTES,
    MAX_TIME_NS,
    Channel,
    Container,
    Damaged,
    Identity,
    Loss,
)
from quadlog.recordings.formatting import instant, several
from quadlog.storage.byte_source import ByteSource, Span

ROW = np.dtype([("t_ns", "<i8"), ("channel", "<i8"), ("begin", "<i8"), ("end", "<i8")])
"""A message of a chunk: its log time, its channel's id, and where its payload lies in the decompressed chunk."""
Rows = np.ndarray[Any, np.dtype[np.void]]
Buffer = bytes | memoryview

_LEAST_RECORDS = 256
_LOOSE_BYTES = 1 << 22
_SEARCHED_BYTES, _MARK_BYTES = 1 << 20, 64


def read_at(file: ByteSource, offset: int, length: int, limit: int = MAX_CHUNK_BYTES) -> bytes:
    """Exactly length bytes from offset on, or Damaged; nothing is allocated above the limit.

    Raises StorageFailed and StorageChanged where a server fails, which is no damage of the file.
    """
    if length > limit:
        raise Damaged(f"{length} bytes at offset {offset} exceed the limit of {limit}", "too-large")
    if offset < 0 or length < 0 or offset > MAX_TIME_NS:
        raise Damaged(f"an offset of {offset} and a length of {length} point nowhere")
    try:
        data = file.read(offset, length)
    except OSError as error:
        raise Damaged(f"the disk does not give what lies at offset {offset} ({error.strerror})") from None
    if len(data) != length:
        raise Damaged(f"the file ends {length - len(data)} bytes too early for what starts at offset {offset}")
    return data


def read_each_at(file: ByteSource, spans: Sequence[Span]) -> list[bytes]:
    """The same of small stretches that lie far apart, MAX_INDEX_BYTES together."""
    wanted = sum(length for _, length in spans)
    if any(offset < 0 or length < 0 for offset, length in spans) or wanted > MAX_INDEX_BYTES:
        raise Damaged(f"message indexes of {wanted} bytes are no message indexes")
    try:
        data = file.read_each(spans)
    except OSError as error:
        raise Damaged(f"the disk does not give a message index ({error.strerror})") from None
    if any(len(each) != length for each, (_, length) in zip(data, spans, strict=True)):
        raise Damaged("the file ends within a message index")
    return data


def name_of(raw: bytes | memoryview) -> str:
    """A topic's, a type's or an encoding's name. Raises Damaged."""
    if len(raw) > MAX_NAME_BYTES:
        raise Damaged(f"a name of {len(raw)} bytes exceeds the limit of {MAX_NAME_BYTES}", "too-large")
    try:
        return bytes(raw).decode()
    except UnicodeDecodeError:
        raise Damaged("a name is not UTF-8") from None


@dataclass(slots=True)
class Chunk:
    """A stretch of the file that is read at once: a chunk, or a run of messages outside chunks (loose).

    length is 0 where only the chunk itself has it. counts (messages for each channel id) and channels are None where
    the index does not say. index_end: offset behind the message index that follows the chunk; 0 where there is none.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    channels: Collection[int] | None = None
    counts: Counter[int] | None = None
    compression: str = ""
    index_end: int = 0
    loose: bool = False

    @property
    def end(self) -> int:
        return self.offset + self.length

    @property
    def is_empty(self) -> bool:
        """Nothing in it, as far as the index says."""
        return self.counts is not None and not any(self.counts.values())

    def may_hold(self, wanted: Mapping[int, Channel], start_ns: int | None, end_ns: int | None) -> bool:
        """Whether any message of the wanted channels with start_ns <= log time < end_ns can be in it."""
        if self.is_empty or (self.channels is not None and wanted.keys().isdisjoint(self.channels)):
            return False
        return (start_ns is None or self.end_ns >= start_ns) and (end_ns is None or self.start_ns < end_ns)


class Body(NamedTuple):
    """A chunk's decompressed records, its messages in file order, and what `_define` takes of the others."""

    data: memoryview
    rows: Rows
    definitions: Sequence[tuple[Any, memoryview]] = ()


def listed_rows(runs: Sequence[tuple[int, Buffer]], entry: np.dtype[np.void]) -> tuple[Rows, Rows]:
    """A row for each entry of a chunk's message indexes, one a channel, with the channel alone; and the entries.

    Raises Damaged where a channel has two.
    """
    numbers = [number for number, _ in runs]
    if len(set(numbers)) < len(numbers):
        raise Damaged("the message index of a chunk names a channel twice")
    entries = np.frombuffer(b"".join(run for _, run in runs), entry)
    rows = np.zeros(len(entries), ROW)
    rows["channel"] = np.repeat(np.array(numbers, np.int64), [len(run) // entry.itemsize for _, run in runs])
    return rows, entries


def counts_of(rows: Rows) -> Counter[int]:
    """Messages for each channel id."""
    return Counter(rows["channel"].tolist())  # a chunk holds few: np.unique takes longer


class ChunkFile(Container):
    """A file of chunks up to where its messages are known; each format is a subclass of ChunkedReader.

    Files without an index, and stretches that it does not cover, are walked record by record.
    """

    _mark: re.Pattern[bytes]
    """Begins where every chunk has its mark, and reads no more than _MARK_BYTES."""

    def __init__(self, path: Path, file: ByteSource, warnings: Sequence[str] = ()) -> None:
        super().__init__(path, warnings)
        self.resources.callback(file.close)
        self._file = file
        self._spare_bytes = compression.Allowance(compression.SPARE_BYTES)
        self._chunks: list[Chunk] = []
        # What the file itself says that it has, for each channel id.
        self._declared: Mapping[int, int] | None = None
        self._definitions: dict[int, int] = {}
        self._definition_room = MAX_DEFINITION_BYTES
        self._trusted = 0
        self._walk_losses: list[Loss] = []
        # By offset: a damaged chunk, and why.
        self._lost: dict[int, tuple[Chunk, Damaged]] = {}

    # What a format is:

    @abstractmethod
    def _open(self) -> None:
        """Find the chunks and what is known of them, by the index or a walk. Raises NothingReadable."""

    @abstractmethod
    def _identities(self) -> Iterable[tuple[int, Identity]]:
        """Channel ids of the file, in order, and what makes them a Channel."""

    @abstractmethod
    def _load(self, chunk: Chunk, at_most: int | None) -> tuple[memoryview, int] | None:
        """A chunk's data, checked and decompressed, and how many bytes it takes in the file; None for one of more than
        at_most bytes. Raises Damaged.
        """

    @abstractmethod
    def _parse(self, data: memoryview, most: int) -> tuple[Rows, int, Sequence[tuple[Any, memoryview]]]:
        """Messages, number of records and definitions in a buffer of whole records, of most + 1 records at most.

        Raises Damaged.
        """

    @abstractmethod
    def _listed(self, chunks: Sequence[Chunk]) -> list[Rows]:
        """All messages of the chunks by their message indexes, with no end of theirs. Raises Damaged."""

    @abstractmethod
    def _step(self, position: int) -> int | None:
        """Take in the record at this offset: where the next one starts, None at the end. Raises Damaged."""

    @abstractmethod
    def _begin_of(self, mark: int) -> int | None:
        """Where the record begins whose mark lies there, None where there is no whole one."""

    @abstractmethod
    def _define(self, kind: Any, content: memoryview) -> None:
        """Take in a record that says what a channel is. Raises Damaged."""

    # Opening:

    def _walk(self, position: int, end: int | None = None) -> None:
        """Take in all records from this offset on, up to a chunk that the index describes, if any. Where they make no
        sense, go on there, or else at the next chunk behind the last one whose end is certain (_trusted).
        """
        following: int | None = position
        self._trusted = position
        while following is not None and following != end:
            position = following
            try:
                following = self._step(position)
                if end is not None and (following is None or following > end):
                    raise Damaged("a record, or the end of the data, overlaps a chunk of the index")
            except Damaged as damage:
                if end is not None:
                    self._lose_stretch(position, end, damage)
                    return
                following = self._resume(position, damage)

    def _resume(self, position: int, damage: Damaged) -> int | None:
        """Where to go on after damage; what lies before is a loss. None where nothing follows."""
        size = self._file.size
        resume = self._find(self._mark, self._trusted)
        if resume == position:
            resume = self._find(self._mark, position + 1)
        if resume is not None and resume < position:  # a record before it has a wrong length
            while self._chunks and self._chunks[-1].end > resume:
                self._chunks.pop()
            position = self._trusted
        self._lose_stretch(position, size if resume is None else resume, damage)
        self._trusted = size if resume is None else resume + 1
        return resume

    def _find(self, mark: re.Pattern[bytes], position: int) -> int | None:
        """Where the first whole record from position on begins that has a mark; None where there is none."""
        while position < self._file.size:
            try:
                block = read_at(self._file, position, min(_SEARCHED_BYTES, self._file.size - position))
            except Damaged:
                return None
            for found in mark.finditer(block):
                if (begin := self._begin_of(position + found.start())) is not None:
                    return begin
            at_end = position + len(block) == self._file.size
            position += len(block) if at_end else len(block) - _MARK_BYTES
        return None

    def _take_walked(self, chunk: Chunk) -> None:
        """A chunk that no index describes: it is read to learn what it holds."""
        try:
            body = self._body(chunk)
            assert body is not None
            for definition in body.definitions:
                self._define(*definition)
        except Damaged as damage:
            self._lose(chunk, damage)
            return
        chunk.counts = counts_of(body.rows)
        if len(body.rows):
            chunk.start_ns, chunk.end_ns = int(body.rows["t_ns"].min()), int(body.rows["t_ns"].max())
        self._chunks.append(chunk)

    def _take_loose(self, position: int, end: int, t_ns: int, number: int) -> None:
        """A message outside chunks: one more of the run that ends there, or the first of a new one."""
        run = self._chunks[-1] if self._chunks else None
        if run is None or not run.loose or run.end != position or end - run.offset > _LOOSE_BYTES:
            run = Chunk(position, 0, t_ns, t_ns, loose=True)
            self._chunks.append(run)
        run.length = end - run.offset
        run.start_ns, run.end_ns = min(run.start_ns, t_ns), max(run.end_ns, t_ns)
        run.counts = run.counts or Counter()
        run.counts[number] += 1

    def _account(self, number: int, size: int) -> None:
        """A definition under its id; one that replaces another gives its room back. Raises Damaged."""
        room = self._definition_room + self._definitions.get(number, 0) - size
        if room < 0:
            raise Damaged(f"message definitions of more than {MAX_DEFINITION_BYTES} bytes", "too-large")
        self._definition_room, self._definitions[number] = room, size

    def _lose_stretch(self, begin: int, end: int, damage: Damaged) -> None:
        last_ns = max((chunk.end_ns for chunk in self._chunks if not chunk.is_empty), default=None)
        until = "nothing before it" if last_ns is None else f"messages until {instant(last_ns)}"
        cause = "truncated" if end == self._file.size else "damaged"
        lost = several(end - begin, "byte")
        self._walk_losses.append(
            Loss(cause, f"{lost} after offset {begin} unreadable ({damage.reason}); read: {until}")
        )

    def _body(self, chunk: Chunk, at_most: int | None = None) -> Body | None:
        """What the chunk holds; None for one of more than at_most bytes. Raises Damaged.

        Time and memory are spent in proportion to what was read: a message takes some bytes of the file, because its
        time and its sequence number change.
        """
        if chunk.loose:
            data, stored_bytes = memoryview(read_at(self._file, chunk.offset, chunk.length)), chunk.length
        elif found := self._load(chunk, at_most):
            data, stored_bytes = found
        else:
            return None
        most = _LEAST_RECORDS + stored_bytes
        rows, records, definitions = self._parse(data, most)
        if records > most:
            raise Damaged(f"it holds more than {most} records", "too-large")
        return Body(data, rows, definitions)

    def _lose(self, chunk: Chunk, damage: Damaged) -> None:
        """Record a damaged chunk."""
        # A traceback would keep the frames of what failed, and with them the chunk's data.
        damage.__traceback__ = damage.__context__ = None
        self._lost[chunk.offset] = chunk, damage
