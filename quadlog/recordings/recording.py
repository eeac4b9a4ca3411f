"""A recording as rows and clouds on one clock, whatever its container and message types."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from copy import copy
from difflib import get_close_matches
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np

from quadlog.config.schema import Config
from quadlog.errors import DecodeError, UnknownTopic, clipped, some_of
from quadlog.messages import NO_ID, UNITS_M, Batch, Int, Message, Timed, Transforms
from quadlog.recordings.clocks.clock import FIRST_STAMPS, Clock, Stamp, settled_ns
from quadlog.recordings.clocks.clock_offsets import FAR_APART_NS, Offsets, one_clock
from quadlog.recordings.containers.container import EXCERPT, Budget, Channel, Container, Loss, RawMessage
from quadlog.recordings.decoders.joints import JointOrder
from quadlog.recordings.decoders.pose_fields import FoundPose
from quadlog.recordings.decoders.range_ends import Ends, ends_of_topic
from quadlog.recordings.decoders.ros_messages import Definitions
from quadlog.recordings.decoding import (
    CloudReader,
    RowReader,
    found_pose,
    kinds_of,
    plugin_notes,
    reader_of,
    way_of,
)
from quadlog.recordings.plugged import messages_of
from quadlog.recordings.reading import Pass, picked, stamps_of
from quadlog.recordings.tf_tree import is_static
from quadlog.recordings.types import own_types
from quadlog.storage.remote_path import to_path

UNPACKED_AT_ONCE = 64
Kind = TypeVar("Kind", bound=Message)
Stamps = tuple[str, str, Int, Int]
"""A topic, a stream and what stamps_of gives of it."""
MARGIN_NS = 10_000_000_000
"""Messages may be logged so much earlier or later than others with their stamps."""


def open_recording(
    path: Path | str, config: Config | None = None, *, msg_path: Sequence[Path | str] = (), stamp: Stamp = "auto"
) -> Recording:
    """Open any recording quadlog reads. Use it as a context manager.

    config: says how topics of its own types are read, between which ends single ranges are, and the order of joints.
    msg_path: folders of .msg files for types the recording does not define.
    Raises RecordingNotFound, NotARecording or NothingReadable.
    """
    from quadlog.recordings.containers.open import open_container

    return Recording(open_container(to_path(path)), config or Config(), msg_path=msg_path, stamp=stamp)


class Recording(AbstractContextManager["Recording"]):
    """Decoded messages of one recording; `losses` and `warnings` grow while it is read.

    mapped: topic -> how it is read by configuration. glimpsed: the stamps of all that a glimpse shows, where somebody
    has read it already.
    """

    def __init__(
        self,
        container: Container,
        config: Config = Config(),  # noqa: B008 - never changed
        *,
        msg_path: Sequence[Path | str] = (),
        stamp: Stamp = "auto",
    ) -> None:
        self.container, self.config, self.stamp = container, config, stamp
        self._definitions = Definitions(msg_path)
        rows = [row for row in config.uwb.range_topics if not (row.field or row.times)]
        self._ends = {r.topic: (r.tag, r.anchor) for r in rows if isinstance(r.tag, int) and isinstance(r.anchor, int)}
        self._units = {row.topic: row.unit for row in rows if row.unit is not None}
        self._anchor_ids = frozenset(anchor.id for anchor in config.uwb.anchors)
        self.mapped = own_types(config)
        self.glimpsed: list[Stamps] | None = None
        self._glimpsed_topics = frozenset(channel.topic for channel in container.channels)
        self.joints = JointOrder(config.robot.joints, config.robot.feet)
        self.clock = Clock(container.path, stamp)
        self._first_lags_ns: dict[str, list[int]] = {}
        self._readers: dict[int, tuple[Channel, RowReader | CloudReader | None]] = {}
        self._peeked: dict[str, tuple[int, list[Batch | Timed], str | None]] = {}
        self._undecodable: dict[str, str] = {}
        self._failures: dict[str, tuple[int, str]] = {}
        self._assumed: dict[str, set[str]] = defaultdict(set)
        self._mended: dict[str, None] = {}

    @property
    def path(self) -> Path:
        """The file or folder."""
        return self.container.path

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Every topic and type."""
        return self.container.channels

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Log times of the first and the last message, None when no index has it."""
        return self.container.span_ns

    @property
    def losses(self) -> list[Loss]:
        """What was in the recording and could not be read, each once."""
        undecodable = self._mixed() | self._undecodable
        own = [Loss("decode", f"cannot be decoded: {why}", topic) for topic, why in undecodable.items()]
        own += [
            Loss("decode", f"{count} messages could not be decoded; the first: {why}", topic, count)
            for topic, (count, why) in self._failures.items()
        ]
        return list(dict.fromkeys([*self.container.losses, *self.clock.losses(), *own]))

    @property
    def warnings(self) -> list[str]:
        """What a user should know about the recording, each once."""
        own = [*self._misnamed_warnings(), *self._assumed_warnings(), *plugin_notes(self.channels), *self._mended]
        return list(dict.fromkeys([*self.container.warnings, *self.clock.warnings(), *own]))

    def _assumed_warnings(self) -> Iterator[str]:
        """Of the ends of ranges that nothing names."""
        if tagless := some_of(sorted(self._assumed["tag"])):
            yield f"{tagless}: no tag is named; ranges are taken as those of tag 0; others:  [[uwb.range_topics]]"
        if order := some_of(sorted(self._assumed["order"])):
            numbers = "of two numbers the first is taken as the tag, the second as the anchor"
            yield f"{order}: {numbers}; [[uwb.range_topics]]"

    def _misnamed_warnings(self) -> Iterator[str]:
        """Of topics that the configuration says how to read and that the recording does not have."""
        named = [("uwb.range_topics", row.topic) for row in self.config.uwb.range_topics]
        named += [("topics.poses", row.topic) for row in self.config.topics.poses]
        there = sorted(self._channels_of)
        all_topics = some_of(there) or "none"
        for key, topic in named:
            if topic not in self._channels_of:
                near = get_close_matches(topic, there)
                hint = f"did you mean {some_of(near)}?" if near else f"topics of the recording: {all_topics}"
                yield f"[[{key}]]: {clipped(topic)} is not in the recording, nothing is read by it; {hint}"

    def types_of(self, topic: str) -> list[str]:
        """The types of the messages on a topic; a sound recording has one per topic."""
        mine = self.channels_of(topic)
        # A writer may have announced a type and then sent no message of it.
        sent = [channel for channel in mine if channel.count != 0] or mine
        return list(dict.fromkeys(channel.type_name for channel in sent))

    def channels_of(self, topic: str) -> tuple[Channel, ...]:
        """The channels of a topic; none for one that the recording does not have."""
        return self._channels_of.get(topic, ())

    @cached_property
    def _channels_of(self) -> dict[str, tuple[Channel, ...]]:
        found: dict[str, list[Channel]] = {}
        for channel in self.channels:
            found.setdefault(channel.topic, []).append(channel)
        return {topic: tuple(channels) for topic, channels in found.items()}

    @cached_property
    def found_poses(self) -> dict[str, FoundPose | str]:
        """Type -> its pose by its definition, or why that is not taken, of types without a decoder of their own."""
        found = {channel.type_name: found_pose(channel) for channel in self.channels}
        return {name: field for name, field in found.items() if field}

    def batches(
        self, topics: Collection[str], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Batch | Timed]:
        """Rows with start_ns <= t_ns < end_ns, many of a topic at once, and clouds without points, one by one.

        Rows come later than clouds that were logged after them. Types that quadlog does not use yield nothing. What
        cannot be decoded is counted as a loss and skipped, as is a topic with two types; a stamp far from its topic's
        others, with a warning. Raises UnknownTopic for one that the recording does not have, at once; and ClocksDiffer
        where the times of these topics and those read before cannot be compared.
        """
        return self.read(self._known(topics), Pass(self, start_ns, end_ns))

    def read(self, topics: Sequence[str], reading: Pass) -> Iterator[Batch | Timed]:
        """What a reading makes of topics; see `batches`."""
        for some in reading.over(self._raws(topics, reading)):
            yield from some

    def messages(
        self, topics: str | Collection[str], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Timed]:
        """The same as single messages in the order they were logged, clouds with their points. Raises as `batches`."""
        known = self._known([topics] if isinstance(topics, str) else topics)
        return self._unpacked(known, Pass(self, start_ns, end_ns, points=True))

    def _unpacked(self, topics: list[str], reading: Pass) -> Iterator[Timed]:
        for window in self._windows(self._raws(topics, reading)):
            found = [each for some in reading.over(window) for each in some]
            yield from _in_order(each for each in found if isinstance(each, Batch))
            yield from (each for each in found if isinstance(each, Timed))

    def _windows(self, raws: Iterable[RawMessage]) -> Iterator[list[RawMessage]]:
        """Messages that are decoded at once: up to a cloud, which is large, or so many."""
        window: list[RawMessage] = []
        for raw in raws:
            window.append(raw)
            if len(window) == UNPACKED_AT_ONCE or isinstance(self.reader(raw.channel), CloudReader):
                yield window
                window = []
        yield window

    def _raws(self, topics: Sequence[str], reading: Pass) -> Iterator[RawMessage]:
        sound = self._sound_topics(topics)
        for topic in sound:
            self._learn(topic)
        return self.container.messages(sound, *self.log_window(topics, reading.start_ns, reading.end_ns))

    def _known(self, topics: Collection[str]) -> list[str]:
        known = list(topics)
        for topic in known:
            if not self.channels_of(topic):
                raise UnknownTopic(None, topic, sorted(self._channels_of))
        return known

    def log_window(
        self, topics: Collection[str], start_ns: int | None, end_ns: int | None
    ) -> tuple[int | None, int | None]:
        """Log times between which all messages of the wanted window must lie, so that an index can find them.

        Log times and stamps may run at different rates, as those of simulated time: where their distance changes, the
        nearest messages of a glimpse bound the window.
        """
        if self.stamp == "log" or (start_ns is None and end_ns is None):
            return start_ns, end_ns
        sound = [topic for topic in self._sound_topics(topics) if not is_static(topic)]
        if self.span_ns is None or not sound:
            return None, None
        lags_ns = np.array([lag_ns for topic in sound for lag_ns in self._learn(topic)])
        seen = [self._usual_times(*each) for each in self._glimpsed(sound) if each[0] in sound]
        log_ns, t_ns = np.concatenate([np.empty((2, 0), np.int64), *seen], axis=1)
        log_ns, t_ns = (each[np.argsort(log_ns, kind="stable")] for each in (log_ns, t_ns))
        lags_ns = np.concatenate([lags_ns, log_ns - t_ns])
        first_ns, last_ns = start_ns, end_ns
        if np.ptp(lags_ns) <= MARGIN_NS:
            first_ns = None if start_ns is None else start_ns + int(lags_ns.min())
            last_ns = None if end_ns is None else end_ns + int(lags_ns.max())
        else:
            before = [] if start_ns is None else log_ns[np.maximum.accumulate(t_ns) < start_ns][-1:].tolist()
            behind = [] if end_ns is None else log_ns[np.minimum.accumulate(t_ns[::-1])[::-1] >= end_ns][:1].tolist()
            first_ns, last_ns = next(iter(before), None), next(iter(behind), None)
        return None if first_ns is None else first_ns - MARGIN_NS, None if last_ns is None else last_ns + MARGIN_NS

    def _usual_times(self, topic: str, stream: str, log_ns: Int, stamp_ns: Int) -> Int:
        """(2, N) log times and times on the clock, without strays."""
        t_ns, stamped = self.clock.placed(topic, stream, stamp_ns, log_ns)
        usual = ~stamped | (np.abs(t_ns - log_ns - self.clock.usual_ns.get(topic, 0)) <= FAR_APART_NS)
        return np.stack([log_ns, t_ns])[:, usual]

    def _glimpsed(self, topics: Collection[str]) -> list[Stamps]:
        """The stamps of topics, and maybe others, in a glimpse; read again if the last one left some out."""
        known = self.glimpsed
        if known is None or not self._glimpsed_topics >= {*topics}:
            known = [(each.topic, *stamps_of(each)) for each in self.glimpse().batches(topics)]
            self.glimpsed, self._glimpsed_topics = known, frozenset(topics)
        return known

    def excerpt(self, budget: Budget) -> Recording | None:
        """The same with a bounded number of its messages, from places spread evenly; None where it is small.

        What either finds is a loss or a warning of both. It is closed with this one.
        """
        part = copy(self)
        part.container = self.container.excerpt(budget) or self.container
        return None if part.container is self.container else part

    def glimpse(self) -> Recording:
        """An excerpt, or all of a small recording, on log times, to look at before it is known which clock will do."""
        part = copy(self)
        part.container = self.container.excerpt(EXCERPT) or self.container
        part.stamp, part.clock = "log", Clock(self.path, "log")
        return part

    def peek(self, topic: str, count: int) -> tuple[list[Batch | Timed], str | None]:
        """What a topic's first few messages hold, at log times, and why none can be decoded, None where some can."""
        known = self._peeked.get(topic)
        if known is None or known[0] < count:
            reading = Pass(self, points=True, timed=False, counted=False)
            parts = reading.over(islice(self.container.messages([topic]), count))
            found = [each for some in parts for each in some]
            known = count, found, None if reading.decoded else reading.why
            if count <= FIRST_STAMPS or not any(isinstance(each, Timed) for each in found):  # clouds are large
                self._peeked[topic] = known
        clouds = [each for each in known[1] if isinstance(each, Timed)][:count]
        rows = [picked(each, each.rows["order"] < count) for each in known[1] if isinstance(each, Batch)]
        return [*(each for each in rows if len(each.rows)), *clouds], known[2]

    def sample(self, topic: str, count: int, kind: type[Kind]) -> list[Kind]:
        """What the first few messages of a topic that can be decoded hold of a kind."""
        found, _ = self.peek(topic, count)
        small = messages_of(each for each in found if isinstance(each, Batch))
        messages = [message for *_, message in small] + [each.message for each in found if isinstance(each, Timed)]
        return [each for each in messages if isinstance(each, kind)]

    def compare_clocks(
        self, topics: Collection[str], tf: Collection[str], compared: Collection[str], reported: Collection[str]
    ) -> None:
        """Find topics, and transforms on the topics tf, on another clock by an excerpt; see clock_offsets."""
        if self.stamp == "log" or self.span_ns is None:
            return
        parts, offsets_ns = defaultdict[str, list[tuple[Int, Int]]](list), defaultdict[str, list[Int]](list)
        glimpsed = [each for each in self._glimpsed(topics) if each[0] in topics]
        for topic, _, log_ns, stamp_ns in glimpsed:
            offsets_ns[topic].append((stamp_ns - log_ns)[stamp_ns > 0])
        usual_ns = settled_ns(offsets_ns)
        for topic, stream, log_ns, stamp_ns in glimpsed:
            offset_ns = stamp_ns - log_ns
            kept = (stamp_ns <= 0) | (np.abs(offset_ns - usual_ns.get(topic, offset_ns)) <= FAR_APART_NS)
            parts[stream if topic in tf else topic].append((log_ns[kept], stamp_ns[kept]))
        streams = {name: Offsets.of(each) for name, each in parts.items()}
        self.clock.one = one_clock(streams, self.span_ns, compared, reported, moves=self.stamp == "auto")
        # What was learned before is of stamps as they were.
        shift_ns = self.clock.one.shift_ns
        self.clock.usual_ns = {topic: each - (shift_ns.get(topic) or 0) for topic, each in usual_ns.items()}
        self.clock.settled = usual_ns.keys()
        self._first_lags_ns.clear()

    def usual_offset_ns(self, topic: str) -> int:
        """Header stamp minus log time of a topic's first messages; 0 without stamps, or where log times are taken."""
        self._learn(topic)
        return self.clock.usual_ns.get(topic, 0)

    def _learn(self, topic: str) -> list[int]:
        """Log time minus stamp of the first few messages of a topic, [0] without; the clock learns what is usual."""
        if self.stamp == "log" or is_static(topic):
            return [0]
        if topic not in self._first_lags_ns:
            offsets_ns: list[int] = []
            for each in self.peek(topic, FIRST_STAMPS)[0]:
                stream, log_ns, stamp_ns = stamps_of(each)
                t_ns, stamped = self.clock.placed(topic, stream, stamp_ns, log_ns)
                offsets_ns += (t_ns - log_ns)[stamped].tolist()
            self.clock.learn(topic, offsets_ns)
            usual_ns = self.clock.usual_ns.get(topic, 0)
            self._first_lags_ns[topic] = [-e for e in offsets_ns if abs(e - usual_ns) <= FAR_APART_NS] or [0]
        return self._first_lags_ns[topic]

    def why_undecodable(self, topic: str) -> str | None:
        """Why no message of a known type can be decoded, or None where some may be."""
        for channel in self.channels_of(topic):
            self.reader(channel)
        return self._undecodable.get(topic)

    def ends_of(self, topic: str) -> Ends | None:
        """Tag and anchor of a topic of single ranges: as configured, else by its name."""
        return ends_of_topic(topic, self._ends, self._anchor_ids)

    def close(self) -> None:
        """Release the file."""
        self.container.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _sound_topics(self, topics: Collection[str]) -> list[str]:
        """Those of the topics that have messages quadlog decodes, all of one type."""
        return [each for each in dict.fromkeys(topics) if self._is_decoded(each) and len(self.types_of(each)) == 1]

    def _is_decoded(self, topic: str) -> bool:
        return any(kinds_of(each, self.mapped) for each in self.channels_of(topic))

    def _mixed(self) -> dict[str, str]:
        """Topic -> why it is not decoded, of those that carry a type quadlog reads beside another one."""
        several = [topic for topic in sorted(self._channels_of) if len(self.types_of(topic)) > 1]
        words = {topic: f"the topic carries several types ({some_of(self.types_of(topic))})" for topic in several}
        return {topic: why for topic, why in words.items() if self._is_decoded(topic)}

    def reader(self, channel: Channel) -> RowReader | CloudReader | None:
        """What reads the channel's payloads; None where there is none, which is a loss if its type is known."""
        if id(channel) not in self._readers:
            reader = None
            try:
                reader = reader_of(channel, self._definitions, self.joints, self.mapped, self._mended.setdefault)
            except DecodeError as error:
                self._undecodable[channel.topic] = error.reason
            # The channel is kept, so its id stays its own.
            self._readers[id(channel)] = channel, reader
        return self._readers[id(channel)][1]

    def count_failures(self, topic: str, count: int, why: str) -> None:
        """So many messages of a topic could not be decoded in a reading; the reading with most is reported."""
        most, first = self._failures.get(topic, (0, why))
        self._failures[topic] = max(most, count), first

    def name_ranges(self, channel: Channel, rows: np.ndarray) -> None:
        """Bring rows of ranges into metres, and name their ends where only the topic does."""
        topic = channel.topic
        if topic in self._units:
            rows["range_m"] *= UNITS_M[self._units[topic]] / UNITS_M[getattr(way_of(channel), "unit", "m")]
        nameless = rows["tag"] == NO_ID
        if nameless.any():
            named = rows["anchor"] != NO_ID
            if (nameless & named).any():
                self._assumed["tag"].add(topic)
            rows["tag"][nameless & named] = 0
            if (nameless & ~named).any() and (ends := self.ends_of(topic)) is not None:
                rows["tag"][nameless & ~named], rows["anchor"][nameless & ~named], assumed = ends
                if assumed:
                    self._assumed[assumed].add(topic)


def _in_order(batches: Iterable[Batch]) -> Iterator[Timed]:
    """Single messages; transforms over time have their times for stamps."""
    timed = (
        each._replace(stamp_ns=each.rows["t_ns"]) if each.kind is Transforms and not is_static(each.topic) else each
        for each in batches
    )
    for _, t_ns, topic, message in messages_of(timed):
        yield Timed(t_ns, topic, message)
