"""The Container for files of chunks (MCAP, ROS 1 bags), on top of the index that opening them made."""

from __future__ import annotations

import os
from collections import Counter, OrderedDict, deque
from collections.abc import Collection, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np

from quadlog.errors import NothingReadable
from quadlog.messages import Int
from quadlog.recordings.containers.bounded_reader import Damaged
from quadlog.recordings.containers.chunks import (
    JUMP_NS,
    Body,
    Contents,
    Entries,
    Listed,
    LostPiece,
    Piece,
    PieceFormat,
    backward_jump_within,
    backward_jumps,
    jump_warning,
    losses_of,
    start_of,
    zero_time_warning,
)
from quadlog.recordings.containers.container import (
    Budget,
    Channel,
    ClosedOnExit,
    LogTimes,
    Loss,
    RawMessage,
    merge_by_time,
    places_within,
    spread,
)
from quadlog.recordings.formatting import several
from quadlog.storage.byte_ranges import ByteSource

# Bodies kept while pieces overlap in time; beyond this they are dropped and read again.
_KEPT_BYTES = 1 << 27
# What may be read again: far more than any recorder's overlap needs, in proportion to what the file is worth.
_AGAIN_BYTES, _AGAIN_RATIO = 1 << 30, 10_000
# Bodies of the file's beginning kept for the next look.
_FIRST_BYTES = 1 << 24
_AHEAD = 2
# Larger bodies are not read ahead, and are in memory alone.
_LARGE_BYTES = 1 << 25
_FREED_BYTES = 1 << 24


class FirstBodies:
    """The first few bodies that were read of a file: every look at some topic's first messages wants them again.

    A pass that comes to its end forgets them, so that of a recording in many files only one holds any.
    """

    def __init__(self) -> None:
        self._bodies: dict[int, Body] = {}
        self._room = _FIRST_BYTES

    def get(self, piece: Piece) -> Body | None:
        """The body, None where it is not one of the first."""
        return self._bodies.get(piece.offset)

    def keep(self, piece: Piece, body: Body) -> None:
        """Keep the body as long as there is room; the first one that does not fit is the last."""
        if piece.offset not in self._bodies:
            self._room -= len(body.data)
            if self._room >= 0:
                self._bodies[piece.offset] = body

    def forget(self) -> None:
        """Forget all bodies."""
        self._bodies.clear()
        self._room = _FIRST_BYTES


class Bodies:
    """Bodies of the due pieces, requested in order of their start; memory stays bounded.

    The next ones are read ahead from the second request on: reading only the first messages ends before.
    """

    def __init__(self, form: PieceFormat, due: Iterable[Piece], first: FirstBodies) -> None:
        self._form, self._first = form, first
        self._begun = False
        self._bodies: OrderedDict[int, Body] = OrderedDict()
        self._bytes = 0
        self._known: set[int] = set()
        self._again_bytes = _AGAIN_BYTES
        self._waiting = deque(sorted((piece for piece in due if first.get(piece) is None), key=start_of))
        self._coming: dict[int, Future[Body | None]] = {}
        self._most_ahead = _most_ahead()
        self._readers = ThreadPoolExecutor(_AHEAD, thread_name_prefix="quadlog-read")
        _let_freed_memory_be_reused()

    def get(self, piece: Piece) -> Body:
        """The body, read again when it was dropped. Raises Damaged."""
        body = self._bodies.get(piece.offset)
        if body is not None:
            self._bodies.move_to_end(piece.offset)
            return body
        body = self._arrived(piece)
        self._account(piece, body)
        while self._bodies and self._bytes + len(body.data) > _KEPT_BYTES:
            self._bytes -= len(self._bodies.popitem(last=False)[1].data)
        self._bodies[piece.offset] = body
        self._bytes += len(body.data)
        return body

    def drop(self, piece: Piece) -> None:
        """Forget the body of a piece that is read to its end."""
        body = self._bodies.pop(piece.offset, None)
        self._bytes -= 0 if body is None else len(body.data)

    def close(self) -> None:
        """Wait for what is being read: the file may be closed afterwards."""
        self._readers.shutdown(cancel_futures=True)

    def _arrived(self, piece: Piece) -> Body:
        body = self._first.get(piece)
        if body is None:
            body = self._read(piece)
            self._first.keep(piece, body)
        self._begun = True
        return body

    def _account(self, piece: Piece, body: Body) -> None:
        if piece.offset not in self._known:
            self._known.add(piece.offset)
            self._again_bytes += _AGAIN_RATIO * body.stored_bytes
            return
        self._again_bytes -= len(body.data)
        if self._again_bytes < 0:
            raise Damaged("too many large chunks overlap in time", "too-large")

    def _read(self, piece: Piece) -> Body:
        if self._waiting and self._waiting[0] is piece:
            self._waiting.popleft()
        coming = self._coming.pop(piece.offset, None)
        if self._begun:
            self._read_ahead()
        body = self._form.load(piece, _LARGE_BYTES) if coming is None else coming.result()
        if body is None:
            self._bodies.clear()
            self._bytes = 0
            body = self._form.load(piece)
        assert body is not None
        return body

    def _read_ahead(self) -> None:
        while self._waiting and len(self._coming) < self._most_ahead:
            piece = self._waiting.popleft()
            self._coming[piece.offset] = self._readers.submit(self._form.load, piece, _LARGE_BYTES)


def _most_ahead() -> int:
    """None where there is but one core: what is decompressed earlier has left its cache when it is decoded."""
    alone = hasattr(os, "sched_getaffinity") and len(os.sched_getaffinity(0)) == 1
    return 0 if alone else _AHEAD


@cache
def _let_freed_memory_be_reused() -> None:
    """Keep Linux's allocator from returning every freed body to the system only to ask for the next one.

    Mapping fresh pages for each body would cost a third of decompressing it.
    glibc keeps up to twice the largest block that was freed (mallopt(3),
    M_MMAP_THRESHOLD); this one is never written, so it takes no memory itself.
    """
    bytes(_FREED_BYTES)


# Messages whose times and places are Python objects at once.
_BLOCK = 1024
_CHANNELS_NAMED = 20
_LISTED_AT_ONCE = 64


class ChunkedReader(ClosedOnExit):
    """Reads pieces through their index: those outside the requested time and topics are not read.

    A piece that turns out damaged is a loss, and the others are still read.
    Counts that the file declares are compared once all of a topic was read. file: the bytes it is read from.
    """

    def __init__(self, path: Path, contents: Contents, form: PieceFormat, file: ByteSource) -> None:
        self.path, self.file = path, file
        self.losses: list[Loss] = []
        self.warnings: list[str] = []
        self.span_ns = contents.span_ns
        self.release, self.close = file.release, file.close
        self._contents, self._form = contents, form
        self.channels = tuple(dict.fromkeys(contents.channel_of.values()))
        self._read_something = False
        self._first = FirstBodies()
        # Kept by place in the file, so that reading twice reports once.
        self._lost: dict[int, LostPiece] = {}
        self._wrong_index: set[int] = set()
        self._undeclared: dict[int, Counter[int]] = {}
        self._jumps_within: dict[int, int] = {}
        self._zero_times: dict[int, int] = {}
        self._miscounts: dict[Channel, Loss] = {}
        self._jumps_between = backward_jumps(contents.pieces)
        self._report()

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """See Container. Raises NothingReadable when every piece there is was damaged."""
        wanted = {
            number: channel
            for number, channel in self._contents.channel_of.items()
            if topics is None or channel.topic in topics
        }
        due = [piece for piece in self._contents.pieces if piece.may_hold(wanted, start_ns, end_ns)]
        bodies = Bodies(self._form, due, self._first)
        asked = _Pass(self, bodies, wanted, start_ns, end_ns)
        try:
            yield from merge_by_time(_PieceMessages(piece, asked) for piece in due)
            self._first.forget()
            if start_ns is None and end_ns is None:
                self._compare_counts(wanted, due, asked.tally)
        finally:
            bodies.close()
            self._report()
        if due and topics is None and not self._read_something and all(piece.offset in self._lost for piece in due):
            raise NothingReadable(self.path, self.losses[-1].detail)

    def log_times(self) -> Iterator[LogTimes]:
        """See Container. Warnings about times are given as if the messages were read."""
        if self._contents.losses:
            raise Damaged(self._contents.losses[0].detail)
        return self._listed_times()

    def _listed_times(self) -> Iterator[LogTimes]:
        tally: Counter[int] = Counter()
        for piece, listed in self._listed_pieces():
            self._examine_times(piece, listed.t_ns, listed.offsets)
            begin = 0
            for number, count in listed.counts.items():
                channel = self._contents.channel_of.get(number)
                if channel is None:
                    raise Damaged(f"the message index names channel {number}, which nothing declares")
                tally[number] += count
                if count:
                    yield LogTimes(piece.start_ns, channel, listed.t_ns[begin : begin + count])
                begin += count
        self._report()
        declared = Counter(self._contents.declared or {})
        if +tally != +declared:
            raise Damaged(f"message indexes list {tally.total()} of {declared.total()} messages")

    def _listed_pieces(self) -> Iterator[tuple[Piece, Listed]]:
        pieces = sorted(self._contents.pieces, key=start_of)
        for begin in range(0, len(pieces), _LISTED_AT_ONCE):
            some = pieces[begin : begin + _LISTED_AT_ONCE]
            yield from zip(some, self._form.listed(some), strict=True)

    def excerpt(self, budget: Budget) -> ChunkedReader | None:
        """See Container. Every channel of which the index knows a chunk has one, up to as many as there are places."""
        pieces = sorted(self._contents.pieces, key=start_of)
        messages = sum((self._contents.declared or {}).values())
        places = places_within(budget, len(pieces), self._stored_bytes(), messages)
        if places is None:
            return None
        chosen = {pieces[index].offset: pieces[index] for index in spread(len(pieces), places)}
        seen = set().union(*(piece.channel_ids or () for piece in chosen.values()))
        rest = iter(pieces if places else ())
        while len(chosen) < 2 * places and (piece := next(rest, None)) is not None:
            if not seen.issuperset(piece.channel_ids or ()):
                chosen[piece.offset] = piece
                seen.update(piece.channel_ids or ())
        # What either of them finds is reported by both.
        excerpt = copy(self)
        excerpt._contents = replace(self._contents, pieces=list(chosen.values()), declared=None)
        return excerpt

    def _stored_bytes(self) -> int:
        """Bytes that the pieces take in the file; a bag's index does not say, so all between the first and the last."""
        pieces = self._contents.pieces
        ends = [piece.offset + piece.length for piece in pieces]
        return max(sum(piece.length for piece in pieces), max(ends, default=0) - min(ends, default=0))

    def entries_of(self, piece: Piece, body: Body) -> Entries:
        """All messages of a body; anomalies are recorded. Raises Damaged."""
        entries = self._form.entries(body)
        self._examine(piece, entries)
        return entries

    def lose(self, piece: Piece, damage: Damaged, read: int) -> None:
        """Record a damaged piece; read: how many of its messages were read nevertheless."""
        counts = self._form.counts(piece)
        missing = None if counts is None else max(sum(counts.values()) - read, 0)
        self._lost[piece.offset] = LostPiece(piece, damage, missing)

    def _examine(self, piece: Piece, entries: Entries) -> None:
        """Record the anomalies of a body: times outside its index's range, jumps, unknown channels."""
        if not len(entries):
            return
        self._read_something = True
        self._examine_times(piece, entries.log_times_ns, entries.begins)
        counts = entries.counts()
        unknown = counts.keys() - self._contents.channel_of.keys()
        if unknown:
            self._undeclared[piece.offset] = Counter({number: counts[number] for number in sorted(unknown)})

    def _examine_times(self, piece: Piece, t_ns: Int, offsets: Int) -> None:
        """Record the anomalies of the log times of a piece's messages; offsets: their places in it."""
        if not len(t_ns):
            return
        earliest_ns, latest_ns = int(t_ns.min()), int(t_ns.max())
        if earliest_ns < piece.start_ns or latest_ns > piece.end_ns:
            self._wrong_index.add(piece.offset)
        if earliest_ns == 0:
            self._zero_times[piece.offset] = int(np.count_nonzero(t_ns == 0))
        if latest_ns - earliest_ns > JUMP_NS:
            jump_ns = backward_jump_within(t_ns[np.argsort(offsets, kind="stable")])
            if jump_ns:
                self._jumps_within[piece.offset] = jump_ns

    def _compare_counts(self, wanted: dict[int, Channel], due: list[Piece], tally: Counter[int]) -> None:
        """What the file says it holds against what was read; pieces known to be lost are not reported twice."""
        declared = self._contents.declared
        if declared is None:
            return
        explained: Counter[int] = Counter()
        for piece in due:
            if piece.offset in self._lost:
                counts = self._form.counts(piece)
                if counts is None:
                    return
                explained.update(counts)
        said: Counter[Channel] = Counter()
        had: Counter[Channel] = Counter()
        for number, channel in wanted.items():
            said[channel] += declared.get(number, 0)
            had[channel] += tally[number] + explained[number]
        for channel in said:
            if said[channel] != had[channel]:
                detail = f"the index counts {several(said[channel], 'message')}, {had[channel]} are in it"
                missing = max(said[channel] - had[channel], 0)
                self._miscounts[channel] = Loss("count", detail, channel.topic, missing)

    def _report(self) -> None:
        """Losses and warnings as they stand now, in place: others hold these lists."""
        unknown = sum((Counter(each) for each in self._undeclared.values()), Counter[int]())
        self.losses[:] = [
            *self._contents.losses,
            *losses_of(self._lost.values()),
            *_undeclared_losses(unknown),
            *self._miscounts.values(),
        ]
        end_ns = self.span_ns[1] if self.span_ns else 0
        self.warnings[:] = [
            *self._contents.warnings,
            *jump_warning(self._jumps_between + list(self._jumps_within.values())),
            *zero_time_warning(sum(self._zero_times.values()), end_ns),
        ]
        if self._wrong_index:
            self.warnings.append(
                f"the index gives wrong times for {several(len(self._wrong_index), 'chunk')}; "
                "a time window may miss messages, and their order may be wrong"
            )


@dataclass(frozen=True, slots=True)
class _Pass:
    """One reading of a file: what is wanted of it, and how many messages of each channel it gave so far."""

    reader: ChunkedReader
    bodies: Bodies
    wanted: dict[int, Channel]
    start_ns: int | None
    end_ns: int | None
    tally: Counter[int] = field(default_factory=Counter)


class _PieceMessages:
    """The wanted messages of one piece (Source). While it waits it holds their places, not their bytes."""

    def __init__(self, piece: Piece, asked: _Pass) -> None:
        self.next_ns: int | None = piece.start_ns
        self._piece, self._asked = piece, asked
        self._entries: Entries | None = None
        self._given = 0

    def until(self, last_ns: int | None) -> Iterator[RawMessage]:
        try:
            entries = self._opened()
            times_ns = entries.log_times_ns
            stop = len(entries) if last_ns is None else int(times_ns.searchsorted(np.int64(last_ns), "right"))
            if self._given < stop:
                yield from self._messages(entries, stop)
        except Damaged as damage:
            self._asked.reader.lose(self._piece, damage, self._given)
            self._end()
            return
        if stop < len(entries):
            self.next_ns = int(times_ns[stop])
        else:
            self._asked.tally.update(entries.counts())
            self._end()

    def _opened(self) -> Entries:
        if self._entries is None:
            asked = self._asked
            entries = asked.reader.entries_of(self._piece, asked.bodies.get(self._piece))
            self._entries = entries.chosen(asked.wanted, asked.start_ns, asked.end_ns)
        return self._entries

    def _messages(self, entries: Entries, stop: int) -> Iterator[RawMessage]:
        data, wanted = self._asked.bodies.get(self._piece).data, self._asked.wanted
        while self._given < stop:
            block = slice(self._given, min(stop, self._given + _BLOCK))
            columns = (entries.log_times_ns, entries.begins, entries.ends, entries.channel_ids)
            for log_time_ns, begin, end, number in zip(*(each[block].tolist() for each in columns), strict=True):
                yield RawMessage(wanted[number], log_time_ns, data[begin:end])
            self._given = block.stop

    def _end(self) -> None:
        self._asked.bodies.drop(self._piece)
        self.next_ns = self._entries = None


def _undeclared_losses(unknown: Counter[int]) -> Iterator[Loss]:
    """A loss for each channel that nothing declares, one for all that are too many to name."""
    for number, count in sorted(unknown.items())[:_CHANNELS_NAMED]:
        detail = f"{several(count, 'message')} of channel {number}, which nothing declares"
        yield Loss("damaged", detail, count=count)
    rest = dict(sorted(unknown.items())[_CHANNELS_NAMED:])
    if rest:
        count = sum(rest.values())
        detail = f"{several(count, 'message')} of {several(len(rest), 'more channel')}, which nothing declares"
        yield Loss("damaged", detail, count=count)
