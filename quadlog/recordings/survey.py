"""What is in a recording: messages per topic, how regularly, on which clock, and who ranges whom."""

from __future__ import annotations

import math
import re
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from statistics import median

import numpy as np

from quadlog.errors import DecodeError
from quadlog.messages import Int, Message, Transforms, UwbRanges
from quadlog.recordings.containers.container import Channel, Container, RawMessage
from quadlog.recordings.decoders.anchor_places import AnchorPlace, AnchorPlaces
from quadlog.recordings.decoders.payload import Payload, PayloadReader
from quadlog.recordings.decoders.ros_messages import standard_types
from quadlog.recordings.recording import Recording

HEADER_TYPE = "std_msgs/msg/Header"
HEADER_LINE = re.compile(r"(std_msgs/(msg/)?)?Header\s+\w+\s*(#.*)?")
IDL_STRUCT = re.compile(r"struct\s+(\w+)\s*\{([^}]*)\}")
FRONT_BYTES = 1 << 16  # of a definition; its first field stands near the top


def stamp_reader(channel: Channel) -> Callable[[Payload], int | None] | None:
    """A function from payload to header.stamp in nanoseconds (None for a broken payload); None without header."""
    if channel.message_encoding not in ("ros1", "cdr") or not starts_with_header(channel):
        return None

    def read(payload: Payload) -> int | None:
        try:
            return PayloadReader(payload, channel.message_encoding, channel.topic).header().stamp_ns
        except DecodeError:
            return None

    return read


def starts_with_header(channel: Channel) -> bool:
    """Whether the message's first field is a std_msgs/Header, by the embedded definition or the standard one."""
    return _starts_with_header(
        channel.type_name, channel.message_encoding, channel.schema_encoding, channel.schema[:FRONT_BYTES]
    )


@lru_cache(maxsize=64)
def _starts_with_header(type_name: str, message_encoding: str, schema_encoding: str, front: bytes) -> bool:
    text = front.decode("utf-8", "replace")
    if not text.strip("\0 \n"):
        fields = standard_types(message_encoding, type_name).get(type_name, ([], []))[1]
        return bool(fields) and fields[0][1][1] == HEADER_TYPE
    if schema_encoding == "ros2idl":
        name = type_name.rpartition("/")[2]
        bodies = [body for struct, body in IDL_STRUCT.findall(text) if struct == name]
        return bool(bodies) and re.sub(r"@\w+\s*(\([^()]*\))?", "", bodies[0]).strip().startswith(
            "std_msgs::msg::Header"
        )
    for line in text.splitlines():
        bare = line.split("#")[0].strip()
        if bare and "=" not in bare:
            return HEADER_LINE.fullmatch(bare) is not None
    return False


RATE_INTERVALS = 10
GAP_MEDIANS = 3


@dataclass(frozen=True, eq=False)
class Pulse:
    """The log times t_ns (N,) of a channel in order, 8 bytes each, and what follows from them."""

    t_ns: Int

    @classmethod
    def of(cls, t_ns: Int) -> Pulse:
        """Of log times in any order."""
        return cls(np.sort(t_ns))

    @property
    def ends_ns(self) -> tuple[int, int] | tuple[None, None]:
        """The earliest and the latest log time."""
        return (int(self.t_ns[0]), int(self.t_ns[-1])) if len(self.t_ns) else (None, None)

    def rates_hz(self) -> tuple[float, float] | tuple[None, None]:
        """The slowest and the fastest of all runs of ten successive intervals; the mean rate twice where there are
        fewer, None where there is none.
        """
        for intervals in (RATE_INTERVALS, len(self.t_ns) - 1):
            runs_ns = self.t_ns[intervals:] - self.t_ns[:-intervals] if intervals > 0 else self.t_ns[:0]
            if runs_ns.max(initial=0) > 0:
                runs_ns = runs_ns[runs_ns > 0]
                return intervals * 1e9 / int(runs_ns.max()), intervals * 1e9 / int(runs_ns.min())
        return None, None

    def gaps(self) -> tuple[int, int]:
        """How many intervals are longer than three medians of those above zero, and the longest (ns)."""
        intervals_ns = np.diff(self.t_ns)
        intervals_ns = intervals_ns[intervals_ns > 0]
        if not len(intervals_ns):
            return 0, 0
        return int((intervals_ns > GAP_MEDIANS * np.median(intervals_ns)).sum()), int(intervals_ns.max())


def indexed_pulses(container: Container) -> dict[Channel, Pulse]:
    """Every channel's pulse from the indexes alone. Raises Damaged where they are not enough."""
    times: dict[int, list[Int]] = {id(channel): [] for channel in container.channels}
    for channel, t_ns in container.log_times():
        times[id(channel)].append(t_ns)
    return {
        channel: Pulse.of(np.concatenate([np.empty(0, np.int64), *times[id(channel)]]))
        for channel in container.channels
    }


OFFSETS_KEPT = 1000

Decoded = tuple[RawMessage, tuple[Message, ...]]
Watch = Callable[[Iterator[Decoded]], Iterator[Decoded]]


@dataclass(frozen=True, slots=True)
class TopicSurvey:
    """One topic with one type.

    first_ns, last_ns, hz_min, hz_max, gaps: of Pulse. clock_offset_s: median of header stamp minus log time over the
    first OFFSETS_KEPT messages read, None without header. clock_jump_s: how far apart the largest and the smallest of
    these differences lie, over all messages read of types that quadlog reads; static transforms may be of any age.
    clock_back_ns, clock_back_to_ns: the farthest that header stamps of one sender's ranges go back from message to
    message, and to when; zero where they never do.
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
class RangeLink:
    """The ranges between one tag and one anchor; None for the ends of ranges that are all no finite numbers."""

    tag: int
    anchor: int
    messages: int
    range_min_m: float | None
    range_max_m: float | None


@dataclass(frozen=True, slots=True)
class Survey:
    """Every topic by name, and every pair of UWB radios that ranged, with first and last log time.

    messages_read: how many were decoded; clocks, links and places are known from these alone. anchor_places: anchor
    id -> where the range messages say that it is. transforms: how many of each topic, parent and child were read.
    """

    topics: tuple[TopicSurvey, ...]
    links: dict[str, tuple[RangeLink, ...]]
    messages: int
    messages_read: int
    start_ns: int | None
    end_ns: int | None
    anchor_places: dict[int, AnchorPlace]
    transforms: Counter[tuple[str, str, str]]


def survey(recording: Recording, pulses: Mapping[Channel, Pulse] | None = None, watch: Watch | None = None) -> Survey:
    """Read everything once, except the coordinates of clouds; memory grows by 8 bytes a message.

    pulses: the log times of all messages (`indexed_pulses`), where the recording
    is an excerpt. watch: passes the messages on, to show how far they are.
    Decoding failures become losses of the recording.
    """
    seen = {id(channel): _Seen(channel) for channel in recording.channels}
    links: dict[str, dict[tuple[int, int], _Reach]] = {}
    transforms: Counter[tuple[str, str, str]] = Counter()
    places = AnchorPlaces()
    passing = recording.everything()
    for raw, decoded in passing if watch is None else watch(passing):
        channel = seen.get(id(raw.channel))
        if channel is None:
            channel = seen[id(raw.channel)] = _Seen(raw.channel)
        channel.take(raw, decoded)
        for message in decoded:
            if isinstance(message, UwbRanges):
                _take_ranges(links.setdefault(raw.channel.topic, {}), message)
                places.take(message)
            elif isinstance(message, Transforms):
                topic = raw.channel.topic
                transforms.update((topic, each.frame_id, each.child_frame_id) for each in message.transforms)
    read = {each.channel: Pulse.of(np.frombuffer(each.t_ns, np.int64)) for each in seen.values()}
    whole = read if pulses is None else pulses
    topics = sorted(
        (each.stamps.survey(each.channel, whole[each.channel]) for each in seen.values()),
        key=lambda each: (each.name, each.type),
    )
    return Survey(
        tuple(topics),
        {topic: tuple(_link(*pair, reach) for pair, reach in sorted(links[topic].items())) for topic in sorted(links)},
        sum(each.messages for each in topics),
        sum(len(each.t_ns) for each in read.values()),
        min((each.first_ns for each in topics if each.first_ns is not None), default=None),
        max((each.last_ns for each in topics if each.last_ns is not None), default=None),
        places.found(),
        transforms,
    )


class _Seen:
    """One channel's messages as they pass."""

    def __init__(self, channel: Channel) -> None:
        self.channel, self.stamps, self.t_ns = channel, _Stamps(channel), array("q")

    def take(self, raw: RawMessage, decoded: tuple[Message, ...]) -> None:
        """One message more."""
        self.t_ns.append(raw.log_time_ns)
        self.stamps.take(raw.log_time_ns, raw.payload, decoded)


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


def _link(tag: int, anchor: int, reach: _Reach) -> RangeLink:
    known = reach.low_m <= reach.high_m
    return RangeLink(tag, anchor, reach.messages, reach.low_m if known else None, reach.high_m if known else None)


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
        (first_ns, last_ns), (hz_min, hz_max), (gaps, longest_ns) = pulse.ends_ns, pulse.rates_hz(), pulse.gaps()
        return TopicSurvey(
            channel.topic,
            channel.type_name,
            len(pulse.t_ns),
            first_ns,
            last_ns,
            hz_min,
            hz_max,
            gaps,
            longest_ns * 1e-9 if longest_ns else None,
            median(self.offsets_ns) * 1e-9 if self.offsets_ns else None,
            None if self._ends_ns is None else (self._ends_ns[1] - self._ends_ns[0]) * 1e-9,
            self.back_ns,
            self.back_to_ns,
        )
