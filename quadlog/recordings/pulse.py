"""Rate and gaps of one channel from its log times, in batches and with bounded memory."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from quadlog.messages import Int
from quadlog.recordings.bounded import MAX_TIME_NS, Damaged
from quadlog.recordings.container import Channel, Container

RATE_INTERVALS = 10
GAP_MEDIANS = 3
BINS_PER_OCTAVE = 50  # an interval's bin is 1.4 % wide
_KEPT_TIMES, _MOST_TIMES = 1 << 18, 1 << 24


@dataclass(eq=False)
class Pulse:
    """Counters, the last few times and a histogram of intervals.

    first_ns, last_ns: the earliest and the latest log time. hz_min, hz_max: the slowest
    and the fastest of all runs of ten successive intervals, zero where there is none.
    """

    messages: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    longest_ns: int = 0
    _shortest_run_ns: int = 0
    _longest_run_ns: int = 0
    _recent_ns: Int = field(default_factory=lambda: np.empty(0, np.int64))
    _intervals: Counter[int] = field(default_factory=Counter)

    def take(self, t_ns: Int) -> None:
        """The next log times (N,), in order."""
        if len(t_ns) == 0:
            return
        self.messages += len(t_ns)
        first_ns, last_ns = int(t_ns.min()), int(t_ns.max())
        self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
        self.last_ns = last_ns if self.last_ns is None else max(self.last_ns, last_ns)
        times_ns = np.concatenate([self._recent_ns, t_ns])
        # Of the times that were there before, only the last one begins an interval that is new.
        self._take_intervals(np.diff(times_ns[max(len(self._recent_ns) - 1, 0) :]))
        self._take_runs(times_ns[RATE_INTERVALS:] - times_ns[:-RATE_INTERVALS])
        self._recent_ns = times_ns[-RATE_INTERVALS:].copy()

    def _take_intervals(self, intervals_ns: Int) -> None:
        intervals_ns = intervals_ns[intervals_ns > 0]
        if len(intervals_ns):
            self.longest_ns = max(self.longest_ns, int(intervals_ns.max()))
            bins, counts = np.unique((np.log2(intervals_ns) * BINS_PER_OCTAVE).astype(np.int64), return_counts=True)
            self._intervals.update(dict(zip(bins.tolist(), counts.tolist(), strict=True)))

    def _take_runs(self, runs_ns: Int) -> None:
        runs_ns = runs_ns[runs_ns > 0]
        if len(runs_ns):
            shortest_ns, longest_ns = int(runs_ns.min()), int(runs_ns.max())
            self._shortest_run_ns = min(self._shortest_run_ns or shortest_ns, shortest_ns)
            self._longest_run_ns = max(self._longest_run_ns, longest_ns)

    def rates_hz(self) -> tuple[float, float] | None:
        """The slowest and the fastest; the mean rate twice where there are fewer than ten intervals, else None."""
        if self._longest_run_ns:
            return RATE_INTERVALS * 1e9 / self._longest_run_ns, RATE_INTERVALS * 1e9 / self._shortest_run_ns
        if self.first_ns is None or self.last_ns is None or self.last_ns <= self.first_ns:
            return None
        mean_hz = (self.messages - 1) * 1e9 / (self.last_ns - self.first_ns)
        return mean_hz, mean_hz

    def gaps(self) -> int:
        """Intervals of more than three medians, to the width of a bin."""
        below, half = 0, sum(self._intervals.values()) / 2
        for interval, count in sorted(self._intervals.items()):
            below += count
            if below >= half:
                limit = interval + math.log2(GAP_MEDIANS) * BINS_PER_OCTAVE
                return sum(count for each, count in self._intervals.items() if each > limit)
        return 0


def indexed_pulses(container: Container) -> dict[Channel, Pulse]:
    """Every channel's pulse from the indexes alone. Raises Damaged where they do not tell.

    Times are put in order as far as files and chunks overlap; so many have to be kept.
    """
    pulses = {channel: Pulse() for channel in container.channels}
    waiting: dict[int, tuple[Channel, list[Int]]] = {}
    kept, limit = 0, _KEPT_TIMES
    for times in container.log_times():
        if kept > limit:
            kept = _take_before(times.floor_ns, waiting, pulses)
            if kept > _MOST_TIMES:
                raise Damaged("the times of its chunks overlap too much")
            limit = 2 * kept + _KEPT_TIMES
        waiting.setdefault(id(times.channel), (times.channel, []))[1].append(times.t_ns)
        kept += len(times.t_ns)
    _take_before(MAX_TIME_NS + 1, waiting, pulses)
    return pulses


def _take_before(t_ns: int, waiting: dict[int, tuple[Channel, list[Int]]], pulses: dict[Channel, Pulse]) -> int:
    """Hand on all times before t_ns; how many are left."""
    left = 0
    for channel, batches in waiting.values():
        times_ns = np.sort(np.concatenate(batches), kind="stable")
        due = int(np.count_nonzero(times_ns < t_ns))
        pulses[channel].take(times_ns[:due])
        batches[:] = [times_ns[due:]]
        left += len(times_ns) - due
    return left
