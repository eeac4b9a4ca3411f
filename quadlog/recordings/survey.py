"""What is in a recording: messages per topic, how regularly, on which clock, and who ranges whom."""

from __future__ import annotations

import re
from array import array
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from statistics import median

import numpy as np

from quadlog.errors import DecodeError
from quadlog.messages import NO_ID, Batch, Int, JointStates, Timed, Transforms, UwbRanges
from quadlog.recordings.containers.container import Channel, Container, RawMessage
from quadlog.recordings.decoders.anchor_places import AnchorPlace, places_of
from quadlog.recordings.decoders.payload import PayloadReader
from quadlog.recordings.decoders.pose_fields import HEADER_TYPE
from quadlog.recordings.decoders.ros_messages import standard_types
from quadlog.recordings.decoding import kinds_of
from quadlog.recordings.reading import Pass, stamps_of
from quadlog.recordings.recording import Recording, Stamps
from quadlog.recordings.tf_tree import is_static
from quadlog.recordings.types import last_part

HEADER_LINE = re.compile(r"(std_msgs/(msg/)?)?Header\s+\w+")
IDL_HEADER = r"\s*\{\s*+(?:@\w+\s*+(?:\([^()]*\))?+\s*+)*+std_msgs::msg::Header"
FRONT_BYTES = 1 << 16  # of a definition; its first field stands near the top
RATE_INTERVALS = 10
GAP_MEDIANS = 3
OFFSETS_KEPT = 1000


@dataclass(frozen=True, slots=True)
class TopicSurvey:
    """One topic with one type.

    first_ns, last_ns: log times. hz_min, hz_max, gaps, longest_gap_s: see rates_hz and gaps. clock_offset_s: median of
    header stamp minus log time over the first OFFSETS_KEPT messages read, None without header. clock_jump_s: how far
    apart the largest and the smallest of these differences lie, over all messages read of types that quadlog reads;
    static transforms may be of any age. clock_back_ns, clock_back_to_ns: the farthest that header stamps of one
    sender's ranges go back from message to message, and to when; zero where they never do.
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
    stamps: of all messages read, if they are to be kept.
    """

    topics: tuple[TopicSurvey, ...]
    links: dict[str, tuple[RangeLink, ...]]
    messages: int
    messages_read: int
    start_ns: int | None
    end_ns: int | None
    anchor_places: dict[int, AnchorPlace]
    transforms: Counter[tuple[str, str, str]]
    stamps: list[Stamps] | None


def indexed_times(container: Container) -> dict[Channel, Int]:
    """Every channel's log times (N,), sorted, from the indexes alone. Raises Damaged where they are not enough."""
    times: dict[int, list[Int]] = {id(channel): [np.empty(0, np.int64)] for channel in container.channels}
    for channel, t_ns in container.log_times():
        times[id(channel)].append(t_ns)
    return {channel: np.sort(np.concatenate(times[id(channel)])) for channel in container.channels}


def rates_hz(t_ns: Int) -> tuple[float, float] | tuple[None, None]:
    """The slowest and the fastest of all runs of ten successive intervals of sorted times; the mean rate twice where
    there are fewer, None where there is none.
    """
    for intervals in (RATE_INTERVALS, len(t_ns) - 1):
        runs_ns = t_ns[intervals:] - t_ns[:-intervals] if intervals > 0 else t_ns[:0]
        if runs_ns.max(initial=0) > 0:
            runs_ns = runs_ns[runs_ns > 0]
            return intervals * 1e9 / int(runs_ns.max()), intervals * 1e9 / int(runs_ns.min())
    return None, None


def gaps(t_ns: Int) -> tuple[int, float | None]:
    """How many intervals of sorted times are longer than three medians of those above zero, and the longest (s)."""
    intervals_ns = np.diff(t_ns)
    intervals_ns = intervals_ns[intervals_ns > 0]
    if not len(intervals_ns):
        return 0, None
    return int((intervals_ns > GAP_MEDIANS * np.median(intervals_ns)).sum()), int(intervals_ns.max()) * 1e-9


def survey(
    recording: Recording,
    times: Mapping[Channel, Int] | None = None,
    watch: Callable[[Iterator[RawMessage]], Iterator[RawMessage]] = lambda raws: raws,
    *,
    keep_stamps: bool = False,
) -> Survey:
    """Read everything once, except the coordinates of clouds; memory grows by 8 bytes a message.

    times: the log times of all messages (`indexed_times`), where the recording
    is an excerpt. watch: passes the messages on, to show how far they are.
    Decoding failures become losses of the recording.
    """
    seen = {id(channel): _Seen(channel, recording) for channel in recording.channels}
    found: dict[str, _Found] = defaultdict(_Found)
    reading, stamps = Pass(recording, timed=False), list[Stamps]()

    def noted() -> Iterator[RawMessage]:
        for raw in watch(recording.container.messages()):
            if id(raw.channel) not in seen:
                seen[id(raw.channel)] = _Seen(raw.channel, recording)
            seen[id(raw.channel)].take(raw)
            yield raw

    for part in reading.over(noted()):
        if some := [*part]:
            found[some[0].topic].take(some)
            stamps += [(each.topic, *stamps_of(each)) for each in some] if keep_stamps else []
    read = {each.channel: np.sort(np.frombuffer(each.log_ns, np.int64)) for each in seen.values()}
    whole = read if times is None else times
    topics = [_surveyed(each, whole[each.channel], found.get(each.channel.topic, _Found())) for each in seen.values()]
    return Survey(
        tuple(sorted(topics, key=lambda each: (each.name, each.type))),
        {topic: tuple(found[topic].range_links()) for topic in sorted(found) if found[topic].reaches},
        sum(each.messages for each in topics),
        sum(map(len, read.values())),
        min((each.first_ns for each in topics if each.first_ns is not None), default=None),
        max((each.last_ns for each in topics if each.last_ns is not None), default=None),
        places_of(rows for each in found.values() for rows in each.placed),
        Counter({(topic, *frames): n for topic in found for frames, n in found[topic].transforms.items()}),
        stamps if keep_stamps else None,
    )


class _Seen:
    """One channel's messages as they pass: log times, and offsets by the first headers of types that are not read."""

    def __init__(self, channel: Channel, recording: Recording) -> None:
        self.channel, self.log_ns, self.offsets_ns = channel, array("q"), list[int]()
        # JointState may be of another machine, whose joints are not read.
        kinds = {*kinds_of(channel, recording.mapped)} - {JointStates}
        read = kinds and recording.why_undecodable(channel.topic) is None
        encodings = channel.message_encoding, channel.schema_encoding
        self._has_header = not read and starts_with_header(channel.type_name, *encodings, channel.schema[:FRONT_BYTES])

    def take(self, raw: RawMessage) -> None:
        """One message more."""
        self.log_ns.append(raw.log_time_ns)
        if self._has_header and len(self.offsets_ns) < OFFSETS_KEPT:
            with suppress(DecodeError):
                reader = PayloadReader(raw.payload, self.channel.message_encoding, self.channel.topic)
                stamp_ns = reader.header().stamp_ns
                self.offsets_ns += [stamp_ns - raw.log_time_ns] if stamp_ns else []


@dataclass
class _Found:
    """What messages of a topic become, as they are read.

    offsets_ns: the first OFFSETS_KEPT; ends_ns: the smallest and the largest of all. back_ns: the farthest step back of
    a sender's stamps, and to when. reaches: (tag, anchor) -> how many ranges, the shortest and the longest. placed:
    rows of ranges with places of anchors. transforms: how many of each parent and child.
    """

    offsets_ns: list[int] = field(default_factory=list)
    ends_ns: tuple[int, int] | None = None
    back_ns: tuple[int, int] = (0, 0)
    reaches: dict[tuple[int, int], tuple[int, float, float]] = field(default_factory=dict)
    placed: list[np.ndarray] = field(default_factory=list)
    transforms: Counter[tuple[str, str]] = field(default_factory=Counter)
    _last_ns: dict[int, int] = field(default_factory=dict)

    def take(self, some: Sequence[Batch | Timed]) -> None:
        """What was read at once, in any order."""
        batches = [each for each in some if isinstance(each, Batch)]
        self._take_stamps(*np.concatenate([_first_stamps(each) for each in some], axis=1))
        for each in batches:
            if each.kind is Transforms:
                self.transforms[each.frame_id, each.child_frame_id] += len(each.rows)
            elif each.kind is UwbRanges and not each.unmeasured:
                self._take_ranges(each.rows)
        self._take_senders([each for each in batches if each.kind is UwbRanges and each.stamp_ns is not None])

    def _take_stamps(self, order: Int, log_ns: Int, stamp_ns: Int) -> None:
        first = np.unique(order, return_index=True)[1]  # a message may hold several
        first = first[stamp_ns[first] != 0]
        offsets_ns = stamp_ns[first] - log_ns[first]
        if len(offsets_ns):
            self.offsets_ns += offsets_ns[: OFFSETS_KEPT - len(self.offsets_ns)].tolist()
            ends_ns = int(offsets_ns.min()), int(offsets_ns.max())
            low_ns, high_ns = self.ends_ns or ends_ns
            self.ends_ns = min(low_ns, ends_ns[0]), max(high_ns, ends_ns[1])

    def _take_senders(self, ranges: Sequence[Batch]) -> None:
        """Stamps of each tag's ranges: those that share a topic may be late by different amounts."""
        stamps = [np.array([each.rows["order"], each.rows["tag"], each.stamp_ns]) for each in ranges]
        order, tag, stamp_ns = np.concatenate([np.empty((3, 0), np.int64), *stamps], axis=1)
        rows = np.argsort(order, kind="stable")
        tag, stamp_ns = tag[rows], stamp_ns[rows]
        for each in np.unique(tag[stamp_ns != 0]).tolist():
            mine_ns = stamp_ns[(tag == each) & (stamp_ns != 0)]
            fall_ns = np.array([self._last_ns.get(each, mine_ns[0]), *mine_ns[:-1]]) - mine_ns
            self._last_ns[each] = int(mine_ns[-1])
            if fall_ns.max() > self.back_ns[0]:
                self.back_ns = int(fall_ns.max()), int(mine_ns[fall_ns.argmax()])

    def _take_ranges(self, rows: np.ndarray) -> None:
        if "anchor_position_m" in (rows.dtype.names or ()):
            self.placed.append(rows[["anchor", "anchor_position_m"]].copy())
        ends = np.stack([rows["tag"], rows["anchor"]], axis=1)
        for tag, anchor in np.unique(ends[(ends != NO_ID).all(axis=1)], axis=0).tolist():
            range_m = rows["range_m"][(ends == (tag, anchor)).all(axis=1)]
            finite_m = range_m[np.isfinite(range_m)]
            n, low_m, high_m = self.reaches.get((tag, anchor), (0, np.inf, -np.inf))
            low_m, high_m = float(finite_m.min(initial=low_m)), float(finite_m.max(initial=high_m))
            self.reaches[tag, anchor] = n + len(range_m), low_m, high_m

    def range_links(self) -> Iterator[RangeLink]:
        """By tag and anchor."""
        for (tag, anchor), (n, low_m, high_m) in sorted(self.reaches.items()):
            yield RangeLink(tag, anchor, n, *((low_m, high_m) if low_m <= high_m else (None, None)))


def _first_stamps(each: Batch | Timed) -> Int:
    """(3, N) orders, log times and header stamps, 0 without, of messages; of several transforms those of the first."""
    _, log_ns, stamp_ns = stamps_of(each)
    if isinstance(each, Timed):
        return np.array([[0], log_ns, stamp_ns])
    stamps = np.array([each.rows["order"], log_ns, stamp_ns])
    return stamps[:, each.rows["index"] == 0] if each.kind is Transforms else stamps


def _surveyed(seen: _Seen, t_ns: Int, found: _Found) -> TopicSurvey:
    """A channel with its log times (N,)."""
    offsets_ns = found.offsets_ns or seen.offsets_ns
    low_ns, high_ns = found.ends_ns or (min(offsets_ns, default=0), max(offsets_ns, default=0))
    (slowest_hz, fastest_hz), (count, longest_s) = rates_hz(t_ns), gaps(t_ns)
    return TopicSurvey(
        seen.channel.topic,
        seen.channel.type_name,
        len(t_ns),
        int(t_ns[0]) if len(t_ns) else None,
        int(t_ns[-1]) if len(t_ns) else None,
        slowest_hz,
        fastest_hz,
        count,
        longest_s,
        median(offsets_ns) * 1e-9 if offsets_ns else None,
        (high_ns - low_ns) * 1e-9 if offsets_ns and not is_static(seen.channel.topic) else None,
        *found.back_ns,
    )


@lru_cache(maxsize=64)
def starts_with_header(type_name: str, message_encoding: str, schema_encoding: str, front: bytes) -> bool:
    """Whether messages begin with a std_msgs/Header, by the front of the embedded definition or the standard one."""
    if message_encoding not in ("ros1", "cdr"):
        return False
    text = front.decode("utf-8", "replace")
    if not text.strip("\0 \n"):
        fields = standard_types(message_encoding, type_name).get(type_name, ([], []))[1]
        return bool(fields) and fields[0][1][1] == HEADER_TYPE
    if schema_encoding == "ros2idl":
        return re.search(rf"struct\s+{re.escape(last_part(type_name))}{IDL_HEADER}", text) is not None
    bare = (line.split("#")[0].strip() for line in text.splitlines())
    first = next((line for line in bare if line and "=" not in line), "")
    return HEADER_LINE.fullmatch(first) is not None
