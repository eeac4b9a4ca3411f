"""The clock of a recording: header stamps or log times, never two distant clocks mixed, and stamps that go back or
repeat.

What is watched is the offset, header stamp minus log time: it jumps wherever
one clock gives way to another. Messages without a stamp have the offset 0.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import ClocksDiffer
from quadlog.messages import Int
from quadlog.recordings.clocks.clock_offsets import BY_LOG, FAR_APART_NS, LATE_NS, OneClock
from quadlog.recordings.containers.container import Loss
from quadlog.recordings.formatting import instant, several, stamps_go_back

Stamp = Literal["auto", "header", "log"]
"""auto: header stamps, those of another clock moved to that of the others."""
Mask = NDArray[np.bool_]

AGREEING_STRAYS = 5  # so many stamps of one other clock are a clock, fewer are slips
MOST_STRAYS = 100
FIRST_STAMPS = 9


@dataclass
class Clock:
    """Chooses t_ns of each message, and compares the offset of every message with those of all topics before it.

    usual_ns: the usual offset of each topic, by its first stamps, or, in settled, by those of the whole log. low, high:
    the smallest and the largest offset met, and of what. strays: topic -> (2, K) stamps far from that and log times.
    zero_stamps: per topic the messages with the stamp 0, in the reading that met most. one: of the topics
    that were compared.
    """

    path: Path
    stamp: Stamp
    usual_ns: dict[str, int] = field(default_factory=dict)
    low: tuple[int, str] | None = None
    high: tuple[int, str] | None = None
    settled: Collection[str] = ()
    strays: dict[str, Int] = field(default_factory=dict)
    zero_stamps: dict[str, int] = field(default_factory=dict)
    one: OneClock = field(default_factory=OneClock)

    def learn(self, topic: str, offsets_ns: Sequence[int]) -> None:
        """The offsets of a topic's first stamps: a slip among them, even the very first, is outvoted."""
        if offsets_ns:
            self.usual_ns.setdefault(topic, sorted(offsets_ns)[len(offsets_ns) // 2])

    def times_ns(self, topic: str, stamp_ns: Int | None, log_ns: Int, stream: str = "") -> tuple[Int, Mask]:
        """When messages (N,) of a topic happened, and which of them are kept: not those of stray stamps.

        stamp_ns: 0, or None for all, where log time is used. stream: the name of a transform. Raises ClocksDiffer once
        two distant clocks have met.
        """
        kept = np.ones(len(log_ns), np.bool_)
        if self.stamp == "log" or not len(log_ns):
            return log_ns, kept
        if stamp_ns is None or not (stamp_ns > 0).any():
            self._meet(0, 0, f"the log time that {topic} must use (its messages have no stamp)")
            return log_ns, kept
        t_ns, stamped = self.placed(topic, stream, stamp_ns, log_ns)
        offset_ns = t_ns - log_ns
        if topic not in self.usual_ns:
            self.learn(topic, offset_ns[stamped][:FIRST_STAMPS].tolist())
        kept = ~stamped | (np.abs(offset_ns - self.usual_ns[topic]) <= FAR_APART_NS)
        if not kept.all():
            self._take_strays(topic, np.stack([t_ns, log_ns])[:, ~kept])
        if len(given_ns := offset_ns[kept]):
            self._meet(int(given_ns.min()), int(given_ns.max()), f"header stamps of {topic}")
        return t_ns, kept

    def placed(self, topic: str, stream: str, stamp_ns: Int, log_ns: Int) -> tuple[Int, Mask]:
        """(N,) times on the clock, strays included, and whether they are those of stamps."""
        stamped = stamp_ns > 0
        return np.where(stamped, self.one.placed_ns(topic, stream, stamp_ns, log_ns), log_ns), stamped

    def _meet(self, low_ns: int, high_ns: int, of: str) -> None:
        self.low, self.high = (
            min(self.low or (low_ns, of), (low_ns, of)),
            max(self.high or (high_ns, of), (high_ns, of)),
        )
        if self.high[0] - self.low[0] > FAR_APART_NS:
            second = self.high[1] if self.high[1] != self.low[1] else "others of the same topic"
            raise ClocksDiffer(self.path, (self.high[0] - self.low[0]) * 1e-9, self.low[1], second)

    def _take_strays(self, topic: str, strays: Int) -> None:
        """(2, K) as in strays; a message that is read twice is one."""
        known = np.unique(np.hstack([self.strays.get(topic, strays), strays]), axis=1)
        self.strays[topic], offset_ns = known, int(strays[0, -1] - strays[1, -1])
        agreeing = (np.abs(known[0] - known[1] - offset_ns) <= FAR_APART_NS).sum()
        if topic not in self.settled and (agreeing >= AGREEING_STRAYS or known.shape[1] >= MOST_STRAYS):
            apart_s = abs(offset_ns - self.usual_ns[topic]) * 1e-9
            raise ClocksDiffer(self.path, apart_s, f"header stamps of {topic}", "others of the same topic")

    def losses(self) -> list[Loss]:
        """One for each topic with more than slips of another clock, which was set for most of the log."""
        found = []
        for topic, (stamp_ns, log_ns) in sorted(self.strays.items()):
            if len(log_ns) >= AGREEING_STRAYS:
                apart_s = np.abs(stamp_ns - log_ns - self.usual_ns[topic]).max() * 1e-9
                what = f"{len(log_ns)} messages stamped up to {apart_s:.0f} s off, {_logged(log_ns)}, are dropped"
                why = f"{A_CLOCK_SET}; {what}; {BY_LOG_TIMES}"
                found.append(Loss("clock", why, topic, len(log_ns)))
        return found

    def warnings(self) -> list[str]:
        """One line for each kind of irregular stamp met so far."""
        zeros = [
            f"{topic}: {count} messages have the stamp 0; their log time is used"
            for topic, count in sorted(self.zero_stamps.items())
            if count
        ]
        zeros += [
            f"{topic}: {several(len(stamps), 'stamp')} from outside of the log (latched, or wrong); {BY_LOG}"
            for topic, stamps in sorted(self.one.outside.items())
        ]
        return [*zeros, *self.one.warnings] + [
            f"{topic}: {len(strays)} header stamps lie more than an hour from its others; those messages are dropped"
            for topic, (strays, _) in sorted(self.strays.items())
            if len(strays) < AGREEING_STRAYS
        ]


SETTLED_SHARE = 2 / 3
"""More of a topic's stamps than this are of the clock that was set; else two clocks differ."""


def settled_ns(offsets_ns: Mapping[str, Sequence[Int]]) -> dict[str, int]:
    """The usual offset of each topic, by those of its stamps in the whole log, where there is a clear one."""
    found = {}
    for topic, parts in offsets_ns.items():
        offset_ns = np.concatenate(parts)
        usual_ns = int(np.median(offset_ns)) if len(offset_ns) else 0
        if (np.abs(offset_ns - usual_ns) <= FAR_APART_NS).sum() > SETTLED_SHARE * len(offset_ns):
            found[topic] = usual_ns
    return found


class Sender(NamedTuple):
    """Stamps t_ns (N,) of one sender of a topic, in the order of the log; log_ns (N,): when they were logged.

    things: what is stamped, in the plural.
    """

    topic: str
    things: str
    log_ns: Int
    t_ns: Int

    @property
    def heard(self) -> tuple[int, int]:
        """In how many seconds of the log, and how often."""
        return len(np.unique(self.log_ns // LATE_NS)), len(self.log_ns)


def goes_back(t_ns: Int) -> bool:
    """Whether one of the stamps (N,) is farther behind the latest one than messages overtake one another."""
    return bool((t_ns < np.maximum.accumulate(t_ns) - LATE_NS).any())


class Passage(NamedTuple):
    """Stamps t_ns (K,) of a wrong clock by log times (K,), and the log times of its nearest neighbours.

    repeats: whether the clock was set back and passes a time again; else it ran ahead until it was set back.
    """

    log_ns: Int
    t_ns: Int
    after_ns: int
    before_ns: int
    repeats: bool

    def rows(self, sender: Sender) -> Mask:
        """(N,) which stamps of a sender are of it: none of one whose clock is not set back then, if it is heard."""
        near = (sender.log_ns > self.after_ns) & (sender.log_ns < self.before_ns)
        along_ns = np.interp(sender.log_ns - self.log_ns[0], self.log_ns - self.log_ns[0], self.t_ns - self.t_ns[0])
        near &= np.abs(sender.t_ns - self.t_ns[0] - along_ns) <= LATE_NS
        within = np.flatnonzero(near)
        beyond = np.flatnonzero(sender.log_ns <= self.after_ns if self.repeats else sender.log_ns >= self.before_ns)
        if len(within) and len(beyond):
            edge = [beyond[-1], within[0]] if self.repeats else [within[-1], beyond[0]]
            before_ns, behind_ns = (sender.t_ns - sender.log_ns)[edge]
            near &= before_ns - behind_ns > LATE_NS
        return near


def left_out(senders: Sequence[Sender]) -> list[Mask]:
    """Of each sender (N,) which stamps to leave out, so that all are those of one passage of time.

    Of one clock `repeated_rows` decides by the sender that is heard longest: all others lose the same stretch.
    """
    masks = [np.zeros(len(each.t_ns), np.bool_) for each in senders]
    passages: list[Passage] = []
    backward = [row for row, each in enumerate(senders) if goes_back(each.t_ns)]
    for row in sorted(backward, key=lambda row: senders[row].heard, reverse=True):
        for passage in passages:
            masks[row] |= passage.rows(senders[row])
        masks[row][~masks[row]] = repeated_rows(senders[row].t_ns[~masks[row]])
        passages += _passages(senders[row], masks[row])
    for row, sender in enumerate(senders):
        for passage in passages if row not in backward else ():
            masks[row] |= passage.rows(sender)
    return masks


def _passages(sender: Sender, mask: Mask) -> list[Passage]:
    """The stretches that a sender loses, if they are long enough for others to lose them too."""
    found = []
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    log_ns = np.concatenate([[-(1 << 62)], sender.log_ns, [1 << 62]])
    for begin, end in edges.reshape(-1, 2).tolist():
        own_ns, t_ns = sender.log_ns[begin:end], sender.t_ns[begin:end]
        if len(t_ns) >= AGREEING_STRAYS and np.ptp(own_ns) >= LATE_NS:
            repeats = begin > 0 and bool(sender.t_ns[begin - 1] > t_ns[0])
            found.append(Passage(own_ns, t_ns, int(log_ns[begin]), int(log_ns[end + 1]), repeats))
    return found


def kept_rows(t_ns: Int, left: Mask, *, equal: bool = False) -> Int:
    """Rows (K,) of stamps (N,), as logged, by time, without those that are left out (N,).

    Late ones are sorted in; of equal ones the first is kept, or, with equal, all.
    """
    rows = np.flatnonzero(~left)
    rows = rows[np.argsort(t_ns[rows], kind="stable")]
    return rows if equal else rows[np.diff(t_ns[rows], prepend=t_ns[rows[:1]] - 1) > 0]


BRIDGED_NS = 10_000_000_000
"""A pause counts no longer where it is asked how much time stamps pass."""


def repeated_rows(t_ns: Int) -> Mask:
    """(N,) bool: the rows to leave out, so that stamps (N,), as logged, are those of one passage of time.

    After a step back, rows are left out until the stamps pass what was
    covered before: what came first stays. But stamps that ran ahead are left
    out instead where they are fewer than AGREEING_STRAYS, of more that follow,
    or passed less than half the time of those behind them: a clock that was
    wrong at first.
    """
    repeated, row = np.zeros(len(t_ns), np.bool_), 0
    latest_ns = np.maximum.accumulate(t_ns)
    fallen = t_ns < latest_ns - LATE_NS
    while row < len(t_ns) and fallen[row := row + int(fallen[row:].argmax())]:
        first, end = np.searchsorted(latest_ns, [t_ns[row], latest_ns[row]], side="right").tolist()
        ahead = first + np.flatnonzero(~repeated[first:row] & (t_ns[first:row] > t_ns[row]))
        slips = ahead[t_ns[ahead] > t_ns[row] + LATE_NS]
        following_ns = np.maximum.accumulate(t_ns[row : row + AGREEING_STRAYS])
        if len(slips) < (following_ns < latest_ns[row] - LATE_NS).sum():
            repeated[slips] = True
        elif 2 * _passed_ns(t_ns[ahead]) < _passed_ns(t_ns[row:end]):
            repeated[ahead] = True
        else:
            repeated[row:end] = True
            row = end
            continue
        latest_ns = np.maximum.accumulate(np.where(repeated, t_ns.min(), t_ns))
        fallen = ~repeated & (t_ns < latest_ns - LATE_NS)
    return repeated


def _passed_ns(t_ns: Int) -> int:
    """How much time stamps (N,) pass, late ones apart; where they go back for good, the longest passage between."""
    highest_ns = np.maximum.accumulate(t_ns[::-1])[::-1]
    passages = np.split(t_ns, np.flatnonzero(np.diff(highest_ns) < -LATE_NS) + 1)
    return max(int(np.minimum(np.diff(np.maximum.accumulate(each)), BRIDGED_NS).sum()) for each in passages)


A_CLOCK_SET, BY_LOG_TIMES = "header stamps are of a clock that was set", "take log times with  --stamp log"


def _logged(log_ns: Int) -> str:
    return f"logged {instant(int(log_ns.min()))} to {instant(int(log_ns.max()))}"


def clock_losses(senders: Sequence[Sender], masks: Sequence[Mask]) -> list[Loss]:
    """One loss for each topic of which stamps are left out: how many, why, and when."""
    losses = []
    for topic, things in dict.fromkeys((each.topic, each.things) for each in senders):
        mine = [(each, mask) for each, mask in zip(senders, masks, strict=True) if each[:2] == (topic, things)]
        total, dropped = sum(len(mask) for _, mask in mine), sum(int(mask.sum()) for _, mask in mine)
        if not dropped:
            continue
        lost_ns = np.concatenate([each.log_ns[mask] for each, mask in mine])
        falls_ns = [(np.maximum.accumulate(each.t_ns) - each.t_ns, each.t_ns) for each, _ in mine]
        back_ns, to_ns = max((int(fall_ns.max()), int(t_ns[fall_ns.argmax()])) for fall_ns, t_ns in falls_ns)
        why = stamps_go_back(back_ns, to_ns) if back_ns > LATE_NS else A_CLOCK_SET
        whose = "whose stamps repeat or run ahead of others"
        what = f"{dropped} of {total} {things} {whose}, {_logged(lost_ns)}, are dropped"
        losses.append(Loss("clock", f"{why}; {what}; {BY_LOG_TIMES}", topic, dropped))
    return losses
