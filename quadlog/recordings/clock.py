"""The clock of a recording: header stamps or log times, and never two distant clocks mixed.

What is watched is the offset, header stamp minus log time: it jumps wherever
one clock gives way to another. Messages without a stamp have the offset 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import ClocksDiffer
from quadlog.messages import Int, Message, Timed, Transforms

Stamp = Literal["header", "log"]

FAR_APART_NS = 3_600_000_000_000
AGREEING_STRAYS = 5  # so many stamps of one other clock are a clock, fewer are slips
MOST_STRAYS = 100
FIRST_STAMPS = 9


@dataclass
class Clock:
    """Chooses t_ns of each message, and compares the offset of every message with those of all topics before it.

    usual_ns: the usual offset of each topic's first stamps. low, high: the smallest and
    the largest offset met, and of what. strays: topic -> stamp -> offset, far from the usual one.
    zero_stamps: per topic the messages with the stamp 0, in the pass that met most.
    """

    path: Path
    stamp: Stamp
    usual_ns: dict[str, int] = field(default_factory=dict)
    low: tuple[int, str] | None = None
    high: tuple[int, str] | None = None
    strays: dict[str, dict[int, int]] = field(default_factory=dict)
    zero_stamps: dict[str, int] = field(default_factory=dict)

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
            t_ns = self.time_ns(topic, message.stamp_ns, log_time_ns)
            return None if t_ns is None else Timed(t_ns, topic, message)
        if message.static or not message.transforms:
            stamp_ns = None if self.stamp == "log" else message.stamp_ns
            return Timed(stamp_ns or log_time_ns, topic, message)
        times = [self.time_ns(topic, each.stamp_ns, log_time_ns) for each in message.transforms]
        kept = [(t_ns, each) for t_ns, each in zip(times, message.transforms, strict=True) if t_ns is not None]
        if not kept:
            return None
        if len(kept) < len(times):
            message = replace(message, stamp_ns=kept[0][1].stamp_ns, transforms=tuple(each for _, each in kept))
        return Timed(kept[0][0], topic, message)

    def time_ns(self, topic: str, stamp_ns: int | None, log_time_ns: int) -> int | None:
        """When a message happened; None for a stray stamp, whose message is to be dropped.

        Raises ClocksDiffer once two distant clocks have met.
        """
        if self.stamp == "log":
            return log_time_ns
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
        self, topic: str, stamp_ns: Int | None, log_time_ns: Int, zeros: dict[str, int]
    ) -> tuple[Int, NDArray[np.bool_]]:
        """The same of many messages (N,) of a topic at once, and which are not to be dropped; stamp_ns: None without.

        Stamps of 0 are counted too: see count_zero_stamps. Raises ClocksDiffer.
        """
        kept = np.ones(len(log_time_ns), dtype=np.bool_)
        if self.stamp == "log" or len(log_time_ns) == 0:
            return log_time_ns, kept
        if stamp_ns is None:
            self.time_ns(topic, None, int(log_time_ns[0]))
            return log_time_ns, kept
        usual = np.zeros(len(log_time_ns), dtype=np.bool_)
        if self.low is not None and self.high is not None:
            offset_ns = stamp_ns - log_time_ns
            usual = (stamp_ns > 0) & (offset_ns >= self.low[0]) & (offset_ns <= self.high[0])
        if usual.all():
            return stamp_ns, kept
        self._count_zeros(topic, int(np.count_nonzero(stamp_ns == 0)), zeros)
        t_ns = stamp_ns.copy()
        for row in np.flatnonzero(~usual).tolist():
            own_ns = self.time_ns(topic, int(stamp_ns[row]), int(log_time_ns[row]))
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
        """One line per oddity met so far."""
        zeros = [
            f"{topic}: {count} messages have the stamp 0; their log time is used"
            for topic, count in sorted(self.zero_stamps.items())
        ]
        return zeros + [
            f"{topic}: {len(strays)} header stamps lie more than an hour from its others; those messages are dropped"
            for topic, strays in sorted(self.strays.items())
        ]
