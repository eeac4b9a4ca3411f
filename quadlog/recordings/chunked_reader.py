"""The Container for files of chunks (MCAP, ROS 1 bags), on top of the index that opening them made."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator
from copy import copy
from dataclasses import replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from types import TracebackType

import numpy as np

from quadlog.errors import NothingReadable
from quadlog.recordings.bodies import Bodies, FirstBodies
from quadlog.recordings.bounded import MAX_TIME_NS, Damaged
from quadlog.recordings.container import Budget, Channel, LogTimes, Loss, RawMessage, places_within, spread
from quadlog.recordings.merging import merge_by_time
from quadlog.recordings.piece_losses import (
    JUMP_NS,
    backward_jump_within,
    backward_jumps,
    jump_warning,
    losses_of,
    zero_time_warning,
)
from quadlog.recordings.pieces import Contents, Entry, Listed, LostPiece, Piece, PieceFormat, start_of
from quadlog.recordings.words import several

_LISTED_AT_ONCE = 64

_log_time = itemgetter(0)


class ChunkedReader:
    """Reads pieces through their index: those outside the asked time and topics are never touched.

    A piece that turns out damaged is a loss, and the others are still read.
    Counts that the file declares are compared once all of a topic was read.
    """

    def __init__(self, path: Path, contents: Contents, form: PieceFormat, close: Callable[[], None]) -> None:
        self.path = path
        self.losses: list[Loss] = []
        self.warnings: list[str] = []
        self.span_ns = contents.span_ns
        self.close = close
        self._contents, self._form = contents, form
        self._channels = tuple(dict.fromkeys(contents.channel_of.values()))
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

    @property
    def channels(self) -> tuple[Channel, ...]:
        return self._channels

    def __enter__(self) -> ChunkedReader:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """See Container. Raises NothingReadable when every piece there is was damaged."""
        wanted = {
            number: channel
            for number, channel in self._contents.channel_of.items()
            if topics is None or channel.topic in topics
        }
        tally: Counter[int] = Counter()
        within = (0 if start_ns is None else start_ns, MAX_TIME_NS + 1 if end_ns is None else end_ns)
        due = [piece for piece in self._contents.pieces if piece.may_hold(wanted, start_ns, end_ns)]
        bodies = Bodies(self._form, due, self._first)
        try:
            yield from merge_by_time(
                (piece.start_ns, partial(self._read_piece, piece, bodies, wanted, within, tally)) for piece in due
            )
            self._first.forget()
            if start_ns is None and end_ns is None:
                self._compare_counts(wanted, due, tally)
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
            self._examine_listed(piece, listed)
            begin = 0
            for number, count in listed.runs:
                channel = self._contents.channel_of.get(number)
                if channel is None:
                    raise Damaged(f"the message index names channel {number}, which nothing declares")
                tally[number] += count
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

    def _examine_listed(self, piece: Piece, listed: Listed) -> None:
        """As _examine does, by the index."""
        if not len(listed.t_ns):
            return
        earliest_ns, latest_ns = int(listed.t_ns.min()), int(listed.t_ns.max())
        if earliest_ns < piece.start_ns or latest_ns > piece.end_ns:
            self._wrong_index.add(piece.offset)
        if earliest_ns == 0:
            self._zero_times[piece.offset] = int((listed.t_ns == 0).sum())
        if latest_ns - earliest_ns > JUMP_NS:
            in_file = listed.t_ns[np.argsort(listed.offsets, kind="stable")]
            if jump_ns := backward_jump_within(in_file):
                self._jumps_within[piece.offset] = jump_ns

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

    def is_divisible(self) -> bool:
        # What is odd about a piece is found whenever any of it is read; what is between pieces, when opening.
        return True

    def _read_piece(
        self, piece: Piece, bodies: Bodies, wanted: dict[int, Channel], within: tuple[int, int], tally: Counter[int]
    ) -> Iterator[RawMessage]:
        start_ns, end_ns = within
        try:
            entries = self._form.entries(bodies.get(piece))
            self._examine(piece, entries)
            entries.sort(key=_log_time)
            for log_time_ns, begin, end, channel_id in entries:
                channel = wanted.get(channel_id)
                if channel is not None and start_ns <= log_time_ns < end_ns:
                    tally[channel_id] += 1
                    yield RawMessage(channel, log_time_ns, bodies.get(piece)[begin:end])
        except Damaged as damage:
            counts = piece.counts if piece.counts is not None else self._form.counts(piece)
            self._lost[piece.offset] = LostPiece(piece, damage, None if counts is None else sum(counts.values()))
        finally:
            bodies.drop(piece)

    def _examine(self, piece: Piece, entries: list[Entry]) -> None:
        """Notes what is odd about a body: times outside its index's range, jumps, unknown channels."""
        if not entries:
            return
        self._read_something = True
        times_ns = [entry[0] for entry in entries]
        earliest_ns, latest_ns = min(times_ns), max(times_ns)
        if earliest_ns < piece.start_ns or latest_ns > piece.end_ns:
            self._wrong_index.add(piece.offset)
        if earliest_ns == 0:
            self._zero_times[piece.offset] = times_ns.count(0)
        jump_ns = backward_jump_within(times_ns)
        if jump_ns:
            self._jumps_within[piece.offset] = jump_ns
        unknown = Counter(entry[3] for entry in entries if entry[3] not in self._contents.channel_of)
        if unknown:
            self._undeclared[piece.offset] = unknown

    def _compare_counts(self, wanted: dict[int, Channel], due: list[Piece], tally: Counter[int]) -> None:
        """What the file says it holds against what was read; pieces known to be lost are not reported twice."""
        declared = self._contents.declared
        if declared is None:
            return
        explained: Counter[int] = Counter()
        for piece in due:
            if piece.offset in self._lost:
                counts = piece.counts if piece.counts is not None else self._form.counts(piece)
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
                detail = f"the file says {several(said[channel], 'message')}, {had[channel]} are in it"
                missing = max(said[channel] - had[channel], 0)
                self._miscounts[channel] = Loss("count", detail, channel.topic, missing)

    def _report(self) -> None:
        """Losses and warnings as they stand now, in place: others hold these lists."""
        unknown = sum((Counter(each) for each in self._undeclared.values()), Counter[int]())
        self.losses[:] = [
            *self._contents.losses,
            *losses_of(self._lost.values()),
            *(
                Loss("damaged", f"{several(count, 'message')} of channel {number}, which nothing declares", count=count)
                for number, count in sorted(unknown.items())
            ),
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
