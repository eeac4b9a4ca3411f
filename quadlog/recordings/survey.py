"""One pass over a whole recording: how many messages per topic, how regularly, on which clock, and who ranges whom."""

from __future__ import annotations

import math
from array import array
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median

from quadlog.messages import Message, Transforms, UwbRanges
from quadlog.recordings.container import Channel
from quadlog.recordings.headers import stamp_reader
from quadlog.recordings.payload_reader import Payload
from quadlog.recordings.recording import Recording

RATE_INTERVALS = 10
GAP_MEDIANS = 3
OFFSETS_KEPT = 1000
BINS_PER_OCTAVE = 50  # an interval's bin is 1.4 % wide


@dataclass(frozen=True, slots=True)
class TopicSurvey:
    """One topic with one type.

    first_ns, last_ns: log times. hz_min, hz_max: the slowest and the fastest of
    all runs of ten successive intervals (of all intervals together where there
    are fewer), None below two messages. gaps: intervals longer than three
    times the median one. clock_offset_s: median of header stamp minus log time
    over the first thousand messages, None without header. clock_jump_s: how far
    apart the largest and the smallest of these differences lie, over all
    messages of types that quadlog reads; static transforms may be of any age.
    clock_back_ns, clock_back_to_ns: the farthest that header stamps of one sender's
    ranges go back from message to message, and to when; zero where they never do.
    """

    name: str
    type: str
    messages: int
    first_ns: int | None
    last_ns: int | None
    hz_min: float | None
    hz_max: float | None
    gaps: int
    longest_gap_s: float | None
    clock_offset_s: float | None
    clock_jump_s: float | None
    clock_back_ns: int
    clock_back_to_ns: int


@dataclass(frozen=True, slots=True)
class Link:
    """The ranges between one tag and one anchor; None for the ends of ranges that are all no finite numbers."""

    tag: int
    anchor: int
    messages: int
    range_min_m: float | None
    range_max_m: float | None


@dataclass(frozen=True, slots=True)
class Survey:
    """Every topic by name, and every pair of UWB radios that ranged, with first and last log time."""

    topics: tuple[TopicSurvey, ...]
    links: dict[str, tuple[Link, ...]]
    messages: int
    start_ns: int | None
    end_ns: int | None


def survey(recording: Recording) -> Survey:
    """Read everything once. Memory does not grow with the recording; decoding failures become its losses."""
    pulses = {id(channel): _Pulse(channel) for channel in recording.channels}
    links: dict[str, dict[tuple[int, int], _Reach]] = {}
    for raw, decoded in recording.everything():
        pulse = pulses.get(id(raw.channel))
        if pulse is None:
            pulse = pulses[id(raw.channel)] = _Pulse(raw.channel)
        pulse.take(raw.log_time_ns, raw.payload, decoded)
        for message in decoded:
            if isinstance(message, UwbRanges):
                _take_ranges(links.setdefault(raw.channel.topic, {}), message)
    topics = tuple(sorted((each.survey() for each in pulses.values()), key=lambda each: (each.name, each.type)))
    starts = [each.first_ns for each in topics if each.first_ns is not None]
    ends = [each.last_ns for each in topics if each.last_ns is not None]
    return Survey(
        topics,
        {topic: tuple(_link(*pair, reach) for pair, reach in sorted(links[topic].items())) for topic in sorted(links)},
        sum(each.messages for each in topics),
        min(starts, default=None),
        max(ends, default=None),
    )


@dataclass
class _Reach:
    messages: int = 0
    low_m: float = math.inf
    high_m: float = -math.inf


def _take_ranges(reaches: dict[tuple[int, int], _Reach], message: UwbRanges) -> None:
    for anchor, range_m in zip(message.anchor.tolist(), message.range_m.tolist(), strict=True):
        if message.tag is not None:
            reach = reaches.setdefault((message.tag, anchor), _Reach())
            reach.messages += 1
            if math.isfinite(range_m):
                reach.low_m, reach.high_m = min(reach.low_m, range_m), max(reach.high_m, range_m)


def _link(tag: int, anchor: int, reach: _Reach) -> Link:
    known = reach.low_m <= reach.high_m
    return Link(tag, anchor, reach.messages, reach.low_m if known else None, reach.high_m if known else None)


@dataclass
class _Pulse:
    """The times of one channel as they pass: counters, a window of the last few, and a histogram of intervals."""

    channel: Channel
    messages: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    hz_min: float = math.inf
    hz_max: float = 0.0
    longest_ns: int = 0
    previous_ns: int | None = None
    recent_ns: deque[int] = field(default_factory=lambda: deque(maxlen=RATE_INTERVALS + 1))
    intervals: Counter[int] = field(default_factory=Counter)
    offsets_ns: array[int] = field(default_factory=lambda: array("q"))
    offset_ends_ns: tuple[int, int] | None = None
    sender_ns: dict[int | None, int] = field(default_factory=dict)
    back_ns: int = 0
    back_to_ns: int = 0
    read_stamp: Callable[[Payload], int | None] | None = None

    def __post_init__(self) -> None:
        self.read_stamp = stamp_reader(self.channel)

    def take(self, t_ns: int, payload: Payload, decoded: tuple[Message, ...]) -> None:
        """One message more."""
        self.messages += 1
        self.first_ns = t_ns if self.first_ns is None else min(self.first_ns, t_ns)
        self.last_ns = t_ns if self.last_ns is None else max(self.last_ns, t_ns)
        if self.previous_ns is not None and t_ns > self.previous_ns:
            self._take_interval(t_ns - self.previous_ns)
        self.previous_ns = t_ns
        self.recent_ns.append(t_ns)
        span_ns = t_ns - self.recent_ns[0]
        if len(self.recent_ns) == RATE_INTERVALS + 1 and span_ns > 0:
            hz = RATE_INTERVALS * 1e9 / span_ns
            self.hz_min, self.hz_max = min(self.hz_min, hz), max(self.hz_max, hz)
        self._take_stamp(t_ns, payload, decoded)
        for message in decoded:
            if isinstance(message, UwbRanges) and message.stamp_ns:
                self._take_sender(message.tag, message.stamp_ns)

    def _take_sender(self, tag: int | None, stamp_ns: int) -> None:
        # Tag by tag: those that share a topic may be late by different amounts.
        back_ns = self.sender_ns.get(tag, stamp_ns) - stamp_ns
        if back_ns > self.back_ns:
            self.back_ns, self.back_to_ns = back_ns, stamp_ns
        self.sender_ns[tag] = stamp_ns

    def _take_interval(self, interval_ns: int) -> None:
        self.longest_ns = max(self.longest_ns, interval_ns)
        self.intervals[int(math.log2(interval_ns) * BINS_PER_OCTAVE)] += 1

    def _take_stamp(self, t_ns: int, payload: Payload, decoded: tuple[Message, ...]) -> None:
        full = len(self.offsets_ns) >= OFFSETS_KEPT
        stamp_ns = None
        if decoded:
            stamp_ns = decoded[0].stamp_ns
        elif self.read_stamp and not full:
            stamp_ns = self.read_stamp(payload)
        if not stamp_ns:
            return
        offset_ns = stamp_ns - t_ns
        if not full:
            self.offsets_ns.append(offset_ns)
        if not (decoded and isinstance(decoded[0], Transforms) and decoded[0].static):
            low_ns, high_ns = self.offset_ends_ns or (offset_ns, offset_ns)
            self.offset_ends_ns = min(low_ns, offset_ns), max(high_ns, offset_ns)

    def survey(self) -> TopicSurvey:
        """The sum of it."""
        hz_min, hz_max = self.hz_min, self.hz_max
        if hz_max == 0.0 and self.first_ns is not None and self.last_ns is not None and self.last_ns > self.first_ns:
            hz_min = hz_max = (self.messages - 1) * 1e9 / (self.last_ns - self.first_ns)
        return TopicSurvey(
            self.channel.topic,
            self.channel.type_name,
            self.messages,
            self.first_ns,
            self.last_ns,
            hz_min if hz_max else None,
            hz_max or None,
            self._gaps(),
            self.longest_ns * 1e-9 if self.longest_ns else None,
            median(self.offsets_ns) * 1e-9 if self.offsets_ns else None,
            (self.offset_ends_ns[1] - self.offset_ends_ns[0]) * 1e-9 if self.offset_ends_ns else None,
            self.back_ns,
            self.back_to_ns,
        )

    def _gaps(self) -> int:
        """Intervals of more than three medians, to the width of a bin."""
        below, half = 0, sum(self.intervals.values()) / 2
        for interval, count in sorted(self.intervals.items()):
            below += count
            if below >= half:
                limit = interval + math.log2(GAP_MEDIANS) * BINS_PER_OCTAVE
                return sum(count for each, count in self.intervals.items() if each > limit)
        return 0
