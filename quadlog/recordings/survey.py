"""What is in a recording: messages per topic, how regularly, on which clock, and who ranges whom."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from statistics import median

import numpy as np

from quadlog.messages import Message, Transforms, UwbRanges
from quadlog.recordings.container import Channel, RawMessage
from quadlog.recordings.headers import stamp_reader
from quadlog.recordings.payload_reader import Payload
from quadlog.recordings.pulse import Pulse
from quadlog.recordings.recording import Recording

OFFSETS_KEPT = 1000
_BATCH = 4096

Decoded = tuple[RawMessage, tuple[Message, ...]]
Watch = Callable[[Iterator[Decoded]], Iterator[Decoded]]


@dataclass(frozen=True, slots=True)
class TopicSurvey:
    """One topic with one type.

    first_ns, last_ns: log times. hz_min, hz_max: the slowest and the fastest of
    all runs of ten successive intervals (of all intervals together where there
    are fewer), None below two messages. gaps: intervals longer than three
    times the median one. clock_offset_s: median of header stamp minus log time
    over the first thousand messages read, None without header. clock_jump_s: how far
    apart the largest and the smallest of these differences lie, over all
    messages read of types that quadlog reads; static transforms may be of any age.
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
    """Every topic by name, and every pair of UWB radios that ranged, with first and last log time.

    messages_read: how many were decoded; clocks and links are known from these alone.
    """

    topics: tuple[TopicSurvey, ...]
    links: dict[str, tuple[Link, ...]]
    messages: int
    messages_read: int
    start_ns: int | None
    end_ns: int | None


def survey(recording: Recording, pulses: Mapping[Channel, Pulse] | None = None, watch: Watch | None = None) -> Survey:
    """Read everything once, except the coordinates of clouds; memory does not grow with the recording.

    pulses: the log times of all messages (`indexed_pulses`), where the recording
    is an excerpt. watch: passes the messages on, to show how far they are.
    Decoding failures become losses of the recording.
    """
    seen = {id(channel): _Seen(channel) for channel in recording.channels}
    links: dict[str, dict[tuple[int, int], _Reach]] = {}
    passing = recording.everything()
    for raw, decoded in passing if watch is None else watch(passing):
        channel = seen.get(id(raw.channel))
        if channel is None:
            channel = seen[id(raw.channel)] = _Seen(raw.channel)
        channel.take(raw, decoded)
        for message in decoded:
            if isinstance(message, UwbRanges):
                _take_ranges(links.setdefault(raw.channel.topic, {}), message)
    read = {each.channel: each.pulse() for each in seen.values()}
    whole = read if pulses is None else pulses
    topics = sorted(
        (each.stamps.survey(each.channel, whole[each.channel]) for each in seen.values()),
        key=lambda each: (each.name, each.type),
    )
    return Survey(
        tuple(topics),
        {topic: tuple(_link(*pair, reach) for pair, reach in sorted(links[topic].items())) for topic in sorted(links)},
        sum(each.messages for each in topics),
        sum(each.messages for each in read.values()),
        min((each.first_ns for each in topics if each.first_ns is not None), default=None),
        max((each.last_ns for each in topics if each.last_ns is not None), default=None),
    )


class _Seen:
    """One channel's messages as they pass; log times are handed on in batches."""

    def __init__(self, channel: Channel) -> None:
        self.channel, self.stamps = channel, _Stamps(channel)
        self._pulse, self._batch_ns = Pulse(), array("q")

    def take(self, raw: RawMessage, decoded: tuple[Message, ...]) -> None:
        """One message more."""
        self._batch_ns.append(raw.log_time_ns)
        if len(self._batch_ns) == _BATCH:
            self.pulse()
        self.stamps.take(raw.log_time_ns, raw.payload, decoded)

    def pulse(self) -> Pulse:
        """What the log times so far tell."""
        self._pulse.take(np.array(self._batch_ns, np.int64))
        self._batch_ns = array("q")
        return self._pulse


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


class _Stamps:
    """Header stamps of one channel against log times, as messages pass."""

    def __init__(self, channel: Channel) -> None:
        self.offsets_ns: array[int] = array("q")
        self.back_ns = self.back_to_ns = 0
        self._ends_ns: tuple[int, int] | None = None
        self._sender_ns: dict[int | None, int] = {}
        self._read_stamp = stamp_reader(channel)

    def take(self, t_ns: int, payload: Payload, decoded: tuple[Message, ...]) -> None:
        """One message more."""
        self._take_offset(t_ns, payload, decoded)
        for message in decoded:
            if isinstance(message, UwbRanges) and message.stamp_ns:
                self._take_sender(message.tag, message.stamp_ns)

    def _take_sender(self, tag: int | None, stamp_ns: int) -> None:
        # Tag by tag: those that share a topic may be late by different amounts.
        back_ns = self._sender_ns.get(tag, stamp_ns) - stamp_ns
        if back_ns > self.back_ns:
            self.back_ns, self.back_to_ns = back_ns, stamp_ns
        self._sender_ns[tag] = stamp_ns

    def _take_offset(self, t_ns: int, payload: Payload, decoded: tuple[Message, ...]) -> None:
        full = len(self.offsets_ns) >= OFFSETS_KEPT
        stamp_ns = None
        if decoded:
            stamp_ns = decoded[0].stamp_ns
        elif self._read_stamp and not full:
            stamp_ns = self._read_stamp(payload)
        if not stamp_ns:
            return
        offset_ns = stamp_ns - t_ns
        if not full:
            self.offsets_ns.append(offset_ns)
        if not (decoded and isinstance(decoded[0], Transforms) and decoded[0].static):
            low_ns, high_ns = self._ends_ns or (offset_ns, offset_ns)
            self._ends_ns = min(low_ns, offset_ns), max(high_ns, offset_ns)

    def survey(self, channel: Channel, pulse: Pulse) -> TopicSurvey:
        """The channel with its log times."""
        hz_min, hz_max = pulse.rates_hz() or (None, None)
        return TopicSurvey(
            channel.topic,
            channel.type_name,
            pulse.messages,
            pulse.first_ns,
            pulse.last_ns,
            hz_min,
            hz_max,
            pulse.gaps(),
            pulse.longest_ns * 1e-9 if pulse.longest_ns else None,
            median(self.offsets_ns) * 1e-9 if self.offsets_ns else None,
            None if self._ends_ns is None else (self._ends_ns[1] - self._ends_ns[0]) * 1e-9,
            self.back_ns,
            self.back_to_ns,
        )
