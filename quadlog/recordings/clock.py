"""The clock of a recording: header stamps or log times, never two distant clocks mixed, and stamps that go back or
repeat.

What is watched is the offset, header stamp minus log time: it jumps wherever
one clock gives way to another. Messages without a stamp have the offset 0.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import ClocksDiffer
from quadlog.messages import Int, Message, Timed, Transforms
from quadlog.recordings.clock_offsets import BY_LOG, FAR_APART_NS, LATE_NS, OneClock
from quadlog.recordings.containers.container import Container, Loss, RawMessage
from quadlog.recordings.formatting import several, stamps_go_back

if TYPE_CHECKING:
    from quadlog.recordings.decoders.columns import Columns

Stamp = Literal["auto", "header", "log"]
"""auto: header stamps, those of another clock moved to that of the others."""

AGREEING_STRAYS = 5  # so many stamps of one other clock are a clock, fewer are slips
MOST_STRAYS = 100
FIRST_STAMPS = 9


@dataclass
class Clock:
    """Chooses t_ns of each message, and compares the offset of every message with those of all topics before it.

    usual_ns: the usual offset of each topic's first stamps. low, high: the smallest and
    the largest offset met, and of what. strays: topic -> stamp -> offset, far from the usual one.
    zero_stamps: per topic the messages with the stamp 0, in the pass that met most. one: of the topics
    that were compared.
    """

    path: Path
    stamp: Stamp
    usual_ns: dict[str, int] = field(default_factory=dict)
    low: tuple[int, str] | None = None
    high: tuple[int, str] | None = None
    strays: dict[str, dict[int, int]] = field(default_factory=dict)
    zero_stamps: dict[str, int] = field(default_factory=dict)
    one: OneClock = field(default_factory=OneClock)

    def learn(self, topic: str, offsets_ns: Sequence[int]) -> None:
        """The offsets of a topic's first stamps: a slip among them, even the very first, is outvoted."""
        if offsets_ns:
            self.usual_ns.setdefault(topic, sorted(offsets_ns)[len(offsets_ns) // 2])

    def count_zero_stamps(self, topic: str, message: Message, zeros: dict[str, int]) -> None:
        """Count stamps of 0, for which log time is used. zeros: those of each topic in this pass.

        Static transforms hold at all times, whatever their stamp.
        """
        if self.stamp == "log" or (isinstance(message, Transforms) and message.static):
            return
        stamped = message.transforms if isinstance(message, Transforms) else (message,)
        self._count_zeros(topic, sum(each.stamp_ns == 0 for each in stamped), zeros)

    def _count_zeros(self, topic: str, count: int, zeros: dict[str, int]) -> None:
        if count:
            zeros[topic] = zeros.get(topic, 0) + count
            self.zero_stamps[topic] = max(zeros[topic], self.zero_stamps.get(topic, 0))

    def timed(self, topic: str, log_time_ns: int, message: Message) -> Timed | None:
        """The message with its time; None when its stamp, or that of all its transforms, is a stray. See time_ns."""
        if not isinstance(message, Transforms):
            t_ns = self.time_ns(topic, message.stamp_ns, log_time_ns, message)
            return None if t_ns is None else Timed(t_ns, topic, message)
        if message.static or not message.transforms:
            stamp_ns = None if self.stamp == "log" else message.stamp_ns
            return Timed(stamp_ns or log_time_ns, topic, message)
        times = [self.time_ns(topic, each.stamp_ns, log_time_ns, each) for each in message.transforms]
        kept = [(t_ns, each) for t_ns, each in zip(times, message.transforms, strict=True) if t_ns is not None]
        if not kept:
            return None
        transforms = tuple(replace(each, stamp_ns=each.stamp_ns and t_ns) for t_ns, each in kept)
        return Timed(kept[0][0], topic, replace(message, stamp_ns=transforms[0].stamp_ns, transforms=transforms))

    def time_ns(self, topic: str, stamp_ns: int | None, log_time_ns: int, of: object = None) -> int | None:
        """When a message or a transform (of) happened; None for a stray stamp, whose message is to be dropped.

        Raises ClocksDiffer once two distant clocks have met.
        """
        if self.stamp == "log":
            return log_time_ns
        placed_ns = stamp_ns and int(self.one.placed_ns(topic, of, stamp_ns, log_time_ns))
        return self._checked_ns(topic, placed_ns, log_time_ns)

    def _checked_ns(self, topic: str, stamp_ns: int | None, log_time_ns: int) -> int | None:
        if not stamp_ns:
            self._meet(0, f"the log time that {topic} must use (its messages have no stamp)")
            return log_time_ns
        offset_ns = stamp_ns - log_time_ns
        if self.low is not None and self.high is not None and self.low[0] <= offset_ns <= self.high[0]:
            return stamp_ns
        if abs(offset_ns - self.usual_ns.setdefault(topic, offset_ns)) > FAR_APART_NS:
            self._take_stray(topic, stamp_ns, offset_ns)
            return None
        self._meet(offset_ns, f"header stamps of {topic}")
        return stamp_ns

    def times_ns(
        self, topic: str, columns: Columns, log_time_ns: Int, zeros: dict[str, int]
    ) -> tuple[Int, NDArray[np.bool_]]:
        """The same of many messages (N,) of a topic at once, and which are not to be dropped.

        Stamps of 0 are counted too: see count_zero_stamps. Raises ClocksDiffer.
        """
        kept, stamp_ns = np.ones(len(log_time_ns), dtype=np.bool_), columns.stamp_ns
        if self.stamp == "log" or len(log_time_ns) == 0:
            return log_time_ns, kept
        if stamp_ns is None:
            self.time_ns(topic, None, int(log_time_ns[0]))
            return log_time_ns, kept
        stamped, usual = stamp_ns > 0, np.zeros(len(log_time_ns), dtype=np.bool_)
        t_ns = np.where(stamped, self.one.placed_ns(topic, columns, stamp_ns, log_time_ns), 0)
        if self.low is not None and self.high is not None:
            offset_ns = t_ns - log_time_ns
            usual = stamped & (offset_ns >= self.low[0]) & (offset_ns <= self.high[0])
        if usual.all():
            return t_ns, kept
        self._count_zeros(topic, int(np.count_nonzero(stamp_ns == 0)), zeros)
        for row in np.flatnonzero(~usual).tolist():
            own_ns = self._checked_ns(topic, int(t_ns[row]), int(log_time_ns[row]))
            t_ns[row], kept[row] = own_ns or 0, own_ns is not None
        return t_ns, kept

    def _meet(self, offset_ns: int, of: str) -> None:
        self.low = min(self.low or (offset_ns, of), (offset_ns, of))
        self.high = max(self.high or (offset_ns, of), (offset_ns, of))
        if self.high[0] - self.low[0] > FAR_APART_NS:
            second = self.high[1] if self.high[1] != self.low[1] else "others of the same topic"
            raise ClocksDiffer(self.path, (self.high[0] - self.low[0]) * 1e-9, self.low[1], second)

    def _take_stray(self, topic: str, stamp_ns: int, offset_ns: int) -> None:
        # By stamp, so that a message that is read twice is one stray.
        strays = self.strays.setdefault(topic, {})
        strays[stamp_ns] = offset_ns
        agreeing = sum(abs(each - offset_ns) <= FAR_APART_NS for each in strays.values())
        if agreeing >= AGREEING_STRAYS or len(strays) >= MOST_STRAYS:
            apart_s = abs(offset_ns - self.usual_ns[topic]) * 1e-9
            raise ClocksDiffer(self.path, apart_s, f"header stamps of {topic}", "others of the same topic")

    def warnings(self) -> list[str]:
        """One line for each kind of irregular stamp met so far."""
        zeros = [
            f"{topic}: {count} messages have the stamp 0; their log time is used"
            for topic, count in sorted(self.zero_stamps.items())
        ]
        zeros += [
            f"{topic}: {several(len(stamps), 'stamp')} from outside of the log (latched, or wrong); {BY_LOG}"
            for topic, stamps in sorted(self.one.outside.items())
        ]
        return [*zeros, *self.one.warnings] + [
            f"{topic}: {len(strays)} header stamps lie more than an hour from its others; those messages are dropped"
            for topic, strays in sorted(self.strays.items())
        ]


MARGIN_NS = 500_000_000
FARTHEST_NS = 10_000_000_000
"""How far beyond an edge a topic is looked for that is silent at the edge itself."""
_LOOK_NS = 1_000_000_000
_ROUNDS = 8


class EdgeMessage(NamedTuple):
    """A message at an edge: when it was logged, and its stamp, or the log time where it has none."""

    topic: str
    log_time_ns: int
    t_ns: int


Look = Callable[[Iterator[RawMessage]], Iterator[EdgeMessage]]


def log_begin(container: Container, topics: Collection[str], start_ns: int, lag_ns: int, look: Look) -> int:
    """Log time before which nothing lies that is stamped start_ns or later; lag_ns: the smallest lag known so far."""
    begin_ns = start_ns + lag_ns - MARGIN_NS
    seen: list[EdgeMessage] = []
    for _ in range(_ROUNDS):
        seen = list(look(container.messages(topics, begin_ns, begin_ns + _LOOK_NS)))
        farther_ns = start_ns + min((each.log_time_ns - each.t_ns for each in seen), default=lag_ns) - MARGIN_NS
        if farther_ns >= begin_ns:
            break
        begin_ns = farther_ns
    first_ns = {each.topic: each.t_ns for each in reversed(seen)}
    late = {topic for topic in topics if first_ns.get(topic, start_ns) >= start_ns}
    high_ns, step_ns, earliest_ns = begin_ns, _LOOK_NS, begin_ns
    while late and high_ns > begin_ns - FARTHEST_NS:
        low_ns = max(high_ns - step_ns, begin_ns - FARTHEST_NS)
        earlier, within = _until(start_ns, look(container.messages(sorted(late), low_ns, high_ns)), late)
        late -= earlier
        earliest_ns = min([earliest_ns, *within])
        high_ns, step_ns = low_ns, 2 * step_ns
    return earliest_ns


def log_end(container: Container, topics: Collection[str], end_ns: int, lag_ns: int, look: Look) -> int:
    """Log time from which on nothing lies that is stamped before end_ns; lag_ns: the largest lag known so far."""
    until_ns = end_ns + lag_ns + MARGIN_NS
    seen: list[EdgeMessage] = []
    for _ in range(_ROUNDS):
        seen = list(look(container.messages(topics, until_ns - _LOOK_NS, until_ns)))
        farther_ns = end_ns + max((each.log_time_ns - each.t_ns for each in seen), default=lag_ns) + MARGIN_NS
        if farther_ns <= until_ns:
            break
        until_ns = farther_ns
    behind = set(topics) - {each.topic for each in seen if each.t_ns >= end_ns}
    latest_ns = until_ns
    if behind:
        for each in look(container.messages(sorted(behind), until_ns, until_ns + FARTHEST_NS)):
            if each.t_ns >= end_ns:
                behind.discard(each.topic)
            elif each.topic in behind:
                latest_ns = each.log_time_ns + 1
            if not behind:
                break
    return latest_ns


def _until(start_ns: int, seen: Iterator[EdgeMessage], topics: Collection[str]) -> tuple[set[str], list[int]]:
    """Topics that begin before start_ns, and when each topic's first message from then on was logged.

    Nothing is read beyond the last of these.
    """
    waiting, earlier, within = set(topics), set[str](), []
    while waiting and (each := next(seen, None)) is not None:
        if each.topic not in waiting:
            continue
        if each.t_ns < start_ns:
            earlier.add(each.topic)
        else:
            waiting.discard(each.topic)
            within.append(each.log_time_ns)
    return earlier, within


def kept_rows(t_ns: Int) -> Int:
    """Rows (K,) of stamps (N,), as logged, by time, which increases strictly.

    Late ones are sorted in; all but the first of equal ones are left out, as are repeated_rows.
    """
    rows = np.flatnonzero(~repeated_rows(t_ns))
    rows = rows[np.argsort(t_ns[rows], kind="stable")]
    return rows[np.concatenate([[True], np.diff(t_ns[rows]) > 0])] if len(rows) else rows


_BRIDGED_NS = 10_000_000_000


class _Kept(NamedTuple):
    """A row that is kept: the latest stamp up to it, and how much time they passed, pauses bridged up to a length."""

    row: int
    latest_ns: int
    passed_ns: int


def repeated_rows(t_ns: Int) -> NDArray[np.bool_]:
    """(N,) bool: the rows to leave out, so that stamps (N,), as logged, are those of one passage of time.

    After a step back, rows are left out until the stamps pass what was
    covered before: what came first stays, so that all senders on one clock
    lose the same stretch. But stamps that ran ahead are left out instead where
    they are fewer than AGREEING_STRAYS, of more that follow, or passed less
    than half the time of those behind them: a clock that was wrong at first.
    """
    repeated = np.zeros(len(t_ns), np.bool_)
    if not (t_ns < np.maximum.accumulate(t_ns) - LATE_NS).any():
        return repeated
    times = t_ns.tolist()
    kept, again, start = list[_Kept](), False, _Kept(-1, min(times), 0)
    for row, time_ns in enumerate(times):
        covered_ns = (kept or [start])[-1].latest_ns
        if not again and time_ns < covered_ns - LATE_NS:
            first = bisect_right(kept, time_ns, key=lambda each: each.latest_ns)
            ahead = [each.row for each in kept[-AGREEING_STRAYS:] if times[each.row] > time_ns + LATE_NS]
            following_ns = np.maximum.accumulate(t_ns[row : row + AGREEING_STRAYS])
            if not 0 < len(ahead) < int((following_ns < covered_ns - LATE_NS).sum()):
                passed_ns = kept[-1].passed_ns - kept[first].passed_ns
                shorter = 2 * passed_ns < _passed_ns(times[row : _row_beyond(t_ns, row, covered_ns)])
                ahead = [each.row for each in kept[first:] if times[each.row] > time_ns] if shorter else []
            repeated[ahead] = True
            tail = [each.row for each in kept[first:] if not repeated[each.row]] if ahead else []
            del kept[first if ahead else len(kept) :]
            for each in tail:
                kept.append(_behind((kept or [start])[-1], each, times[each]))
            covered_ns = (kept or [start])[-1].latest_ns
            again = time_ns < covered_ns - LATE_NS
        if again and time_ns <= covered_ns:
            repeated[row] = True
            continue
        again = False
        kept.append(_behind((kept or [start])[-1], row, time_ns))
    return repeated


def _behind(last: _Kept, row: int, time_ns: int) -> _Kept:
    latest_ns = max(last.latest_ns, time_ns)
    return _Kept(row, latest_ns, last.passed_ns + min(latest_ns - last.latest_ns, _BRIDGED_NS))


def _row_beyond(t_ns: Int, row: int, covered_ns: int) -> int:
    """The first row from this one on whose stamp is later than what was covered; N where there is none."""
    beyond = t_ns[row:] > covered_ns
    return row + int(beyond.argmax()) if beyond.any() else len(t_ns)


def _passed_ns(times_ns: Sequence[int]) -> int:
    """The time that stamps pass, as _Kept.passed_ns."""
    return int(np.minimum(np.diff(np.maximum.accumulate(times_ns)), _BRIDGED_NS).sum())


def clock_losses(topic: str, things: str, senders: Iterable[Int]) -> list[Loss]:
    """No loss or one: what repeated_rows leaves out of a topic; senders: their stamps (N,), as logged."""
    total = dropped = 0
    worst = (0, 0)
    for t_ns in senders:
        total += len(t_ns)
        if count := int(repeated_rows(t_ns).sum()):
            dropped += count
            back_ns = np.maximum.accumulate(t_ns) - t_ns
            row = int(back_ns.argmax())
            worst = max(worst, (int(back_ns[row]), int(t_ns[row])))
    if not dropped:
        return []
    detail = f"{stamps_go_back(*worst)}; {dropped} of {total} {things} whose stamps repeat or run ahead of others"
    return [Loss("clock", f"{detail} are dropped; take log times with  --stamp log", topic, dropped)]
