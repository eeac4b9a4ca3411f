"""The Container for files of chunks (MCAP, ROS 1 bags): messages in order of time, read ahead; and what is lost."""

from __future__ import annotations

import os
from collections import Counter, deque
from collections.abc import Collection, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from copy import copy
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadlog.errors import NothingReadable, some_of
from quadlog.recordings.containers.chunk_file import Body, Chunk, ChunkFile, Rows, counts_of
from quadlog.recordings.containers.compression import SUPPORTED
from quadlog.recordings.containers.container import (
    JUMP_NS,
    MAX_TIME_NS,
    Budget,
    Channel,
    Damaged,
    LogTimes,
    Loss,
    RawMessage,
    merge_by_time,
    places_within,
    shared_channels,
    spread,
    starts_back_ns,
)
from quadlog.recordings.formatting import instant, several
from quadlog.storage.byte_source import ByteSource, Kept

_DAY_NS = 86_400 * 10**9
# Of the file's beginning, kept for the next look.
_FIRST_BYTES = 1 << 24
# Larger chunks are not read ahead.
_LARGE_BYTES = 1 << 25
# With one core, what is decompressed earlier has left its cache when it is decoded.
_AHEAD = 0 if hasattr(os, "sched_getaffinity") and len(os.sched_getaffinity(0)) == 1 else 2
_LISTED_AT_ONCE = 64
# Data in memory of chunks that overlap in time; that of others is kept on disk.
_HELD_BYTES = 1 << 27
# Messages whose times and places are Python objects at once.
_BLOCK = 1024
# glibc reuses freed blocks up to the largest one freed (mallopt(3), M_MMAP_THRESHOLD): fresh pages for each chunk would
# cost a third of decompressing it. This one is never written, so it takes no memory itself.
bytes(1 << 24)

_START = attrgetter("start_ns")
_OFFSET = attrgetter("offset")


class _Odd(NamedTuple):
    """What is odd about a chunk's messages."""

    outside_index: bool
    zero_times: int
    jump_ns: int
    undeclared: Counter[int]


class _OnDisk:
    """Data in a temporary file. Raises Damaged where there is no room for it."""

    def __init__(self, file: Kept, data: memoryview) -> None:
        offset = file.append(data)
        if offset is None:
            raise Damaged("too many large chunks overlap in time", "too-large")
        self._file, self._offset = file, offset

    def __getitem__(self, part: slice) -> memoryview:
        return memoryview(self._file.read(self._offset + part.start, part.stop - part.start))


class _Reading:
    """One reading of some channels in start_ns <= log time < end_ns: what it has in memory, and what it found.

    counts: by the offset of a chunk, its messages for each channel id.
    """

    def __init__(self, wanted: Mapping[int, Channel], start_ns: int | None, end_ns: int | None) -> None:
        self._wanted, self._start_ns, self._end_ns = wanted, start_ns, end_ns
        self.counts: dict[int, Counter[int]] = {}
        self._held_bytes, self._disk = 0, Kept()

    def _chosen(self, rows: Rows) -> Rows:
        """Those that are wanted, in order of log time."""
        keep = np.fromiter(map(self._wanted.__contains__, rows["channel"].tolist()), np.bool_, len(rows))
        if self._start_ns is not None:
            keep &= rows["t_ns"] >= min(self._start_ns, MAX_TIME_NS)
        if self._end_ns is not None and self._end_ns <= MAX_TIME_NS:
            keep &= rows["t_ns"] < self._end_ns
        rows = rows[keep]
        t_ns = rows["t_ns"]
        return rows[np.argsort(t_ns, kind="stable")] if np.any(t_ns[1:] < t_ns[:-1]) else rows

    def blocks(self, body: Body) -> Iterator[Iterable[RawMessage]]:
        """Messages of a chunk, whose data is held until the last one is given. Raises Damaged."""
        rows, data, size, wanted = self._chosen(body.rows), body.data, len(body.data), self._wanted
        held: memoryview | _OnDisk = data
        if self._held_bytes and self._held_bytes + size > _HELD_BYTES and len(rows):
            held, size = _OnDisk(self._disk, data), 0
        del body, data
        self._held_bytes += size
        for at in range(0, len(rows), _BLOCK):
            columns = rows[at : at + _BLOCK].view(np.int64).reshape(-1, 4).T.tolist()
            yield (
                RawMessage(wanted[number], t_ns, held[begin:end])
                for t_ns, number, begin, end in zip(*columns, strict=True)
            )
        self._held_bytes -= size


class ChunkedReader(ChunkFile):
    """Chunks outside the requested time and topics are not read, where there is an index.

    A chunk that turns out damaged is a loss, and the others are still read. Findings are kept by offset: reading twice
    reports once.
    """

    def __init__(self, path: Path, file: ByteSource, warnings: Sequence[str] = ()) -> None:
        super().__init__(path, file, warnings)
        self._odd: dict[int, _Odd] = {}
        self._miscounts: dict[Channel, Loss] = {}
        # The first few bodies, shared with excerpts: every look at some topic's first messages wants them again.
        self._first: dict[int, Body] = {}
        self._read_something = False
        self._open()
        for chunk in self._chunks:
            chunk.channels = chunk.counts if chunk.channels is None else chunk.channels
        held = [chunk for chunk in self._chunks if not chunk.is_empty]
        if held and self.span_ns is None:
            self.span_ns = min(map(_START, held)), max(chunk.end_ns for chunk in held)
        declared = sum((each.counts or Counter() for each in self._chunks), Counter[int]())
        declared = self._declared = declared if self._declared is None else Counter(self._declared)
        self._channel_of = shared_channels((n, identity, declared[n]) for n, identity in self._identities())
        self.channels = tuple(dict.fromkeys(self._channel_of.values()))
        spans = [(chunk.start_ns, chunk.end_ns) for chunk in sorted(held, key=_OFFSET) if chunk.end_ns]
        self._jumps_between = [back_ns for back_ns in starts_back_ns(spans) if back_ns]
        for chunk, _ in self._lost.values():
            chunk.counts = self._counts(chunk)
        self._opening_losses = self.losses
        unknown = sorted({chunk.compression for chunk in held}.difference(SUPPORTED))
        if held and all(chunk.compression in unknown for chunk in held):
            names = ", ".join(map(repr, unknown))
            raise NothingReadable(path, f"compressed with {names}, which quadlog does not read (zstd, lz4 or none)")
        serious = [loss for loss in self.losses if loss.cause not in ("summary", "index")]
        if not held and serious:
            raise NothingReadable(path, serious[-1].detail)

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """See Container. Raises NothingReadable when every chunk there is was damaged."""
        wanted = {n: channel for n, channel in self._channel_of.items() if topics is None or channel.topic in topics}
        due = sorted((each for each in self._chunks if each.may_hold(wanted, start_ns, end_ns)), key=_OFFSET)
        reading, bodies = _Reading(wanted, start_ns, end_ns), self._read_ahead(sorted(due, key=_START))
        try:
            streams = (chain.from_iterable(self._blocks_of(chunk, bodies, reading)) for chunk in due)
            yield from merge_by_time(zip(map(_START, due), streams, strict=True))
        finally:
            bodies.close()
        self._first.clear()
        self._file.check_unchanged()
        if start_ns is None and end_ns is None:
            self._compare_counts(wanted, due, reading.counts)
        if due and topics is None and not self._read_something and all(chunk.offset in self._lost for chunk in due):
            raise NothingReadable(self.path, self.losses[-1].detail)

    def _blocks_of(
        self, chunk: Chunk, bodies: Iterator[Body | Damaged], reading: _Reading
    ) -> Iterator[Iterable[RawMessage]]:
        """Wanted messages of a chunk, whose body is the next one, in order of time."""
        try:
            body = next(bodies)
            if isinstance(body, Damaged):
                raise body
            counts = reading.counts[chunk.offset] = counts_of(body.rows)
            self._examine(chunk, body.rows, counts)
            self._read_something |= len(body.rows) > 0
            blocks = reading.blocks(body)
            del body
            yield from blocks
        except Damaged as damage:
            chunk.counts = self._counts(chunk)
            self._lose(chunk, damage)

    def _read_ahead(self, due: Sequence[Chunk]) -> Generator[Body | Damaged]:
        """Each chunk's body, or what is wrong with it; from the second one on, the next two are being read meanwhile:
        reading only the first messages ends before.
        """
        with ThreadPoolExecutor(2, thread_name_prefix="quadlog-read") as readers:
            coming: deque[Future[Body | Damaged | None]] = deque()
            for number, chunk in enumerate(due):
                body = coming.popleft().result() if coming else None
                behind = due[number + len(coming) + 1 : number + _AHEAD + 1] if number else ()
                coming.extend(readers.submit(self._tried, each, _LARGE_BYTES) for each in behind)
                body = body or self._tried(chunk)
                assert body is not None
                yield body
                del body

    def _tried(self, chunk: Chunk, at_most: int | None = None) -> Body | Damaged | None:
        """As `_body`; the file's first few are kept until a reading comes to its end."""
        if (body := self._first.get(chunk.offset)) is not None:
            return body
        try:
            body = self._body(chunk, at_most)
        except Damaged as damage:
            return damage
        kept = [*self._first.values()]
        if body is not None and sum(len(each.data) for each in (*kept, body)) <= _FIRST_BYTES:
            self._first[chunk.offset] = body
        return body

    def log_times(self) -> Iterator[LogTimes]:
        """See Container. Warnings about times are given as if the messages were read."""
        if self._opening_losses:
            raise Damaged(self._opening_losses[0].detail)
        tally: Counter[int] = Counter()
        for at in range(0, len(self._chunks), _LISTED_AT_ONCE):
            some = self._chunks[at : at + _LISTED_AT_ONCE]
            for chunk, rows in zip(some, self._listed(some), strict=True):
                rows = rows[np.argsort(rows["channel"], kind="stable")]
                numbers, begins, counts = np.unique(rows["channel"], return_index=True, return_counts=True)
                tally.update(counted := dict(zip(numbers.tolist(), counts.tolist(), strict=True)))
                self._examine(chunk, rows, counted)
                for number, t_ns in zip(numbers.tolist(), np.split(rows["t_ns"], begins[1:]), strict=False):
                    if (channel := self._channel_of.get(number)) is None:
                        raise Damaged(f"the message index names channel {number}, which nothing declares")
                    yield LogTimes(channel, t_ns)
        self._file.check_unchanged()
        declared = Counter(self._declared or {})
        if +tally != +declared:
            raise Damaged(f"message indexes list {tally.total()} of {declared.total()} messages")

    def excerpt(self, budget: Budget) -> ChunkedReader | None:
        """See Container. Every channel of which the index knows a chunk has one, up to as many as there are places."""
        chunks = sorted(self._chunks, key=_START)
        # A bag's index does not say how long chunks are: all between the first and the last.
        between = max((each.end for each in chunks), default=0) - min(map(_OFFSET, chunks), default=0)
        stored_bytes = max(sum(chunk.length for chunk in chunks), between)
        places = places_within(budget, len(chunks), stored_bytes, sum((self._declared or {}).values()))
        if places is None:
            return None
        chosen = {chunks[index].offset: chunks[index] for index in spread(len(chunks), places)}
        seen = set().union(*(chunk.channels or () for chunk in chosen.values()))
        for chunk in chunks if places else ():
            if len(chosen) < 2 * places and not seen.issuperset(chunk.channels or ()):
                chosen[chunk.offset] = chunk
                seen.update(chunk.channels or ())
        # What either of them finds is reported by both.
        excerpt = copy(self)
        excerpt._chunks, excerpt._declared = list(chosen.values()), None
        return excerpt

    def _counts(self, chunk: Chunk) -> Counter[int] | None:
        """Messages for each channel id without reading the chunk, None where nothing says."""
        if chunk.counts is not None or not chunk.index_end:
            return chunk.counts
        try:
            return counts_of(self._listed([chunk])[0]) or None
        except Damaged:
            return None

    def _examine(self, chunk: Chunk, rows: Rows, counts: Mapping[int, int]) -> None:
        """Record what is odd about a chunk's messages. counts: how many there are, by channel id."""
        if not len(t_ns := rows["t_ns"]):
            return
        earliest_ns, latest_ns, jump_ns = int(t_ns.min()), int(t_ns.max()), 0
        if latest_ns - earliest_ns > JUMP_NS:
            in_file = t_ns[np.argsort(rows["begin"], kind="stable")]
            jump_ns = int((np.maximum.accumulate(in_file) - in_file).max())
        zero_times = 0 if earliest_ns else int(np.count_nonzero(t_ns == 0))
        unknown = Counter({number: counts[number] for number in counts.keys() - self._channel_of.keys()})
        outside = earliest_ns < chunk.start_ns or latest_ns > chunk.end_ns
        self._odd[chunk.offset] = _Odd(outside, zero_times, jump_ns, unknown)

    def _compare_counts(self, wanted: dict[int, Channel], due: list[Chunk], read: dict[int, Counter[int]]) -> None:
        """What the file says it holds against what was read; chunks known to be lost are not reported twice."""
        if self._declared is None:
            return
        present: Counter[int] = Counter()
        for chunk in due:
            counts = chunk.counts if chunk.offset in self._lost else read[chunk.offset]
            if counts is None:
                return
            present.update(counts)
        said, had = Counter[Channel](), Counter[Channel]()
        for number, channel in wanted.items():
            said[channel] += self._declared.get(number, 0)
            had[channel] += present[number]
        for channel, count in said.items():
            if count != had[channel]:
                detail = f"the index counts {several(count, 'message')}, {had[channel]} are in it"
                self._miscounts[channel] = Loss("count", detail, channel.topic, max(count - had[channel], 0))

    @property
    def losses(self) -> list[Loss]:
        """Those of the index, of chunks, of stretches without chunks, of messages that nothing declares, and counts."""
        undeclared = sum((each.undeclared for each in self._odd.values()), Counter[int]())
        unknown = f"{several(undeclared.total(), 'message')} of channels that nothing declares"
        numbers = some_of([str(number) for number in sorted(undeclared)])
        undeclared_loss = Loss("damaged", f"{unknown}: {numbers}", count=undeclared.total())
        return [
            *super().losses,
            *self._losses_of_chunks(),
            *self._walk_losses,
            *([undeclared_loss] if undeclared else []),
            *self._miscounts.values(),
        ]

    @property
    def warnings(self) -> list[str]:
        """Those of opening, and of the times of messages."""
        odd, warnings = self._odd.values(), super().warnings
        jumps_ns = [*self._jumps_between, *(each.jump_ns for each in odd if each.jump_ns > JUMP_NS)]
        zeros, wrong = sum(each.zero_times for each in odd), sum(each.outside_index for each in odd)
        if jumps_ns:
            times, most_s = several(len(jumps_ns), "time"), max(jumps_ns) / 1e9
            warnings.append(
                f"log time goes back {times} in the file, by up to {most_s:.3f} s; messages come in order of log time"
            )
        if zeros and self.span_ns and self.span_ns[1] >= _DAY_NS:
            until = instant(self.span_ns[1])
            warnings.append(f"{several(zeros, 'message')} logged at time 0, the others until {until}")
        if wrong:
            warnings.append(
                f"the index gives wrong times for {several(wrong, 'chunk')}; "
                "a time window may miss messages, and their order may be wrong"
            )
        return warnings

    def _losses_of_chunks(self) -> Iterator[Loss]:
        """One for each cause, in the order in which the first of its chunks lies in the file."""
        groups: dict[str, list[tuple[Chunk, Damaged]]] = {}
        for _, (chunk, damage) in sorted(self._lost.items()):
            groups.setdefault(damage.cause, []).append((chunk, damage))
        for cause, group in groups.items():
            known = [chunk.counts.total() for chunk, _ in group if chunk.counts is not None]
            count = sum(known) if len(known) == len(group) else None
            messages = "an unknown number of messages" if count is None else several(count, "message")
            start_ns, end_ns = min(each.start_ns for each, _ in group), max(each.end_ns for each, _ in group)
            chunks = f"{several(len(group), 'chunk')} with {messages} between {instant(start_ns)} and {instant(end_ns)}"
            first = f"{'first' if len(group) > 1 else 'it lies'} at offset {group[0][0].offset}"
            yield Loss(cause, f"{chunks} lost; {first}: {group[0][1].reason}", count=count)
