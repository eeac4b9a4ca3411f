"""A recording as typed messages on one clock, whatever its container and message types."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import copy
from functools import cached_property
from itertools import islice
from pathlib import Path

import numpy as np

from quadlog.config.schema import Config
from quadlog.errors import DecodeError, UnknownJoints, UnknownTopic, some_of
from quadlog.messages import Int, Message, Timed, Transforms, UwbRanges
from quadlog.recordings.clock import FIRST_STAMPS, Clock, EdgeMessage, Stamp, log_begin, log_end
from quadlog.recordings.clock_offsets import FAR_APART_NS, Offsets, one_clock, stream_name
from quadlog.recordings.containers.container import EXCERPT, Budget, Channel, ClosedOnExit, Container, Loss, RawMessage
from quadlog.recordings.decoders.joints import JointOrder
from quadlog.recordings.decoders.pose import is_static
from quadlog.recordings.decoders.pose_fields import PoseField
from quadlog.recordings.decoders.ros_messages import Definitions
from quadlog.recordings.decoders.uwb import Ends, ends_of_topic, in_metres, names_anchors, with_ends
from quadlog.recordings.decoding import Decoder, decoder_for, found_pose, is_cloud, is_decodable, ways_in_columns
from quadlog.recordings.gathering import Gathered, Many, One, Pass, Waiting, timed_columns
from quadlog.storage.remote_path import to_path


def open_recording(
    path: Path | str,
    *,
    stamp: Stamp = "auto",
    msg_path: Sequence[Path | str] = (),
    range_topics: Mapping[str, tuple[int, int]] | None = None,
    anchor_ids: Collection[int] = (),
    joints: JointOrder | None = None,
) -> Recording:
    """Open any recording quadlog reads. Use it as a context manager.

    msg_path: folders of .msg files for types the recording does not define;
    range_topics: topic -> (tag, anchor) for topics of single ranges; joints: their order, None: detected.
    Raises RecordingNotFound, NotARecording or NothingReadable.
    """
    from quadlog.recordings.containers.open import open_container

    return Recording(
        open_container(to_path(path)),
        stamp=stamp,
        definitions=Definitions([Path(folder) for folder in msg_path]),
        range_topics=range_topics or {},
        anchor_ids=anchor_ids,
        joints=joints,
    )


def open_configured(path: Path, config: Config, msg_path: Sequence[Path] = (), stamp: Stamp = "auto") -> Recording:
    """The recording with the topics' ends and anchors that the configuration knows. Raises as open_recording does."""
    rows = config.uwb.range_topics
    recording = open_recording(
        path,
        stamp=stamp,
        msg_path=msg_path,
        range_topics={r.topic: (r.tag, r.anchor) for r in rows if r.tag is not None and r.anchor is not None},
        anchor_ids=[anchor.id for anchor in config.uwb.anchors],
        joints=JointOrder(config.robot.joints, config.robot.feet),
    )
    recording.range_units = {r.topic: r.unit for r in rows if r.unit is not None}
    return recording


class Recording(ClosedOnExit):
    """Decoded messages of one recording; `losses` and `warnings` grow while it is read.

    range_units: topic -> "m", "cm" or "mm", where its ranges are not in the unit of their type.
    """

    def __init__(
        self,
        container: Container,
        *,
        stamp: Stamp = "auto",
        definitions: Definitions | None = None,
        range_topics: Mapping[str, tuple[int, int]] | None = None,
        anchor_ids: Collection[int] = (),
        joints: JointOrder | None = None,
    ) -> None:
        self.container, self.stamp = container, stamp
        self._definitions = definitions or Definitions()
        self._range_topics, self._anchor_ids = dict(range_topics or {}), frozenset(anchor_ids)
        self.range_units: dict[str, str] = {}
        self.joints = joints or JointOrder()
        self.clock = Clock(container.path, stamp)
        self._learned: set[str] = set()
        self._first_lags: dict[str, list[int]] = {}
        self._decoders: dict[tuple[int, bool], tuple[Channel, Decoder | None]] = {}
        self._undecodable: dict[str, str] = {}
        self._why_undecodable: dict[tuple[str, str, str, bytes], str | None] = {}
        self._failures: dict[str, tuple[int, str]] = {}
        self._tagless: set[str] = set()
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
        return list(dict.fromkeys([*self.container.losses, *own]))

    @property
    def warnings(self) -> list[str]:
        """What a user should know about the recording, each once."""
        tagless = [f"{topic}: names no tag; its ranges are taken as those of tag 0" for topic in sorted(self._tagless)]
        return list(dict.fromkeys([*self.container.warnings, *self.clock.warnings(), *tagless, *self._mended]))

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
    def found_poses(self) -> dict[str, PoseField | str]:
        """Type -> its pose by its definition, or why that is not taken, of types without a decoder of their own."""
        found = {channel.type_name: found_pose(channel) for channel in self.channels}
        return {name: field for name, field in found.items() if field}

    def messages(
        self, topics: str | Collection[str], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Timed]:
        """Decoded messages with start_ns <= t_ns < end_ns, in the order they were logged, one at a time.

        Of one topic or several; those of types that quadlog does not use yield
        nothing. What cannot be decoded is counted as a loss and skipped, as is
        a topic with two types; a stamp far from its topic's others, with a
        warning. Raises UnknownTopic for one that the recording does not have,
        at once; and ClocksDiffer where the times of these topics and those read
        before cannot be compared.
        """
        topics = [topics] if isinstance(topics, str) else list(topics)
        self._check_known(topics)
        return self._within(topics, start_ns, end_ns)

    def gathered(
        self,
        topics: Collection[str],
        start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[Gathered]:
        """The same messages, but small ones of a topic many at a time, as columns, which come late; clouds lack points.

        Faster where all are wanted. Raises as `messages`.
        """
        self._check_known(topics)
        return self._gathered(topics, start_ns, end_ns)

    def _gathered(self, topics: Collection[str], start_ns: int | None, end_ns: int | None) -> Iterator[Gathered]:
        wanted = self._sound_topics(topics)
        self._learn_clocks(wanted)
        reading = Pass(start_ns, end_ns)
        waiting: dict[int, Waiting | None] = {}
        for order, raw in enumerate(self.container.messages(wanted, *self.log_window(topics, start_ns, end_ns))):
            try:
                own = waiting[id(raw.channel)]
            except KeyError:
                ways = () if raw.channel.topic in self.range_units else ways_in_columns(raw.channel, self.joints)
                own = waiting[id(raw.channel)] = Waiting(raw.channel, ways) if ways else None
            if own is None or not own.take(order, raw):
                yield from self._singly(order, raw, reading, points=False)
            elif own.is_full:
                yield from self._columns(own, reading)
        for left in waiting.values():
            if left is not None:
                yield from self._columns(left, reading)

    def _columns(self, waiting: Waiting, reading: Pass) -> Iterator[Gathered]:
        """All that waits on a channel; what does not fit into columns comes message by message, behind them."""
        channel, orders, log_times_ns, payloads = waiting.channel, *waiting.drain()
        if not payloads:
            return
        left = np.ones(len(payloads), dtype=np.bool_)
        decoder = waiting.decoder(payloads[0], self._definitions)
        for rows, columns in () if decoder is None else decoder.decode(payloads):
            left[rows] = False
            yield from timed_columns(self.clock, channel.topic, columns, orders[rows], log_times_ns[rows], reading)
        for row in np.flatnonzero(left).tolist():
            raw = RawMessage(channel, int(log_times_ns[row]), payloads[row])
            yield from self._singly(int(orders[row]), raw, reading)

    def _singly(self, order: int, raw: RawMessage, reading: Pass, *, points: bool = True) -> Iterator[One]:
        for message in self._decode_or_count(raw, reading, points=points):
            timed = self.clock.timed(raw.channel.topic, raw.log_time_ns, message)
            if timed is not None and reading.holds(timed.t_ns):
                yield One(order, timed.t_ns, timed.topic, timed.message)

    def _check_known(self, topics: Collection[str]) -> None:
        for topic in topics:
            if not self.channels_of(topic):
                raise UnknownTopic(None, topic, sorted(self._channels_of))

    def _within(self, topics: list[str], start_ns: int | None, end_ns: int | None) -> Iterator[Timed]:
        wanted, reading = self._sound_topics(topics), Pass(start_ns, end_ns)
        self._learn_clocks(wanted)
        for raw in self.container.messages(wanted, *self.log_window(topics, start_ns, end_ns)):
            for one in self._singly(0, raw, reading):
                yield Timed(one.t_ns, one.topic, one.message)

    def log_window(
        self, topics: Collection[str], start_ns: int | None, end_ns: int | None
    ) -> tuple[int | None, int | None]:
        """Log times between which all messages of the wanted window must lie, so that an index can find them."""
        if self.stamp == "log" or (start_ns is None and end_ns is None):
            return start_ns, end_ns
        if self.span_ns is None:
            return None, None
        sound = self._sound_topics(topics)
        self._learn_clocks(sound)
        lags = [lag for topic in sound for lag in self._first_lags.get(topic, ())] or [0]
        return (
            None if start_ns is None else log_begin(self.container, sound, start_ns, min(lags), self._look),
            None if end_ns is None else log_end(self.container, sound, end_ns, max(lags), self._look),
        )

    def everything(self) -> Iterator[tuple[RawMessage, tuple[Message, ...]]]:
        """Every message of the recording, and what it decodes to: nothing for types quadlog does not use.

        Clouds are checked as for use, but come without points.
        """
        reading = Pass()
        for raw in self.container.messages():
            yield raw, self._decode_or_count(raw, reading, points=False) if is_decodable(raw.channel) else ()

    def excerpt(self, budget: Budget) -> Recording | None:
        """The same with a bounded number of its messages, from places spread evenly; None where it is small.

        What either finds is a loss or a warning of both. It is closed with this one.
        """
        container = self.container.excerpt(budget)
        if container is None:
            return None
        part = copy(self)
        part.container = container
        return part

    def glimpse(self) -> Recording:
        """An excerpt, or all of a small recording, on log times, to look at before it is known which clock will do."""
        part = copy(self)
        part.container = self.container.excerpt(EXCERPT) or self.container
        part.stamp, part.clock = "log", Clock(self.path, "log")
        return part

    def sample(self, topic: str, count: int) -> list[Message]:
        """The first few messages of a topic that can be decoded, for a look at their content."""
        found: list[Message] = []
        for raw in islice(self.container.messages([topic]), count):
            with suppress(DecodeError):
                found += self._decode(raw)
        return found

    def compare_clocks(
        self, topics: Collection[str], tf: Collection[str], compared: Collection[str], reported: Collection[str]
    ) -> None:
        """Find topics, and transforms on the topics tf, on another clock by an excerpt; see clock_offsets."""
        if self.stamp == "log" or self.span_ns is None:
            return
        parts: dict[str, list[Int]] = {}
        for each in self.glimpse().gathered(topics):
            message = each.columns if isinstance(each, Many) else each.message
            for one in message.transforms if isinstance(message, Transforms) else (message,):
                name = stream_name(each.topic, one) if each.topic in tf else each.topic
                stamp_ns = np.zeros_like(each.t_ns) if one.stamp_ns is None else one.stamp_ns
                parts.setdefault(name, []).append(np.array([each.t_ns, stamp_ns]).reshape(2, -1))
        streams = {name: Offsets.of(each) for name, each in parts.items()}
        self.clock.one = one_clock(streams, self.span_ns, compared, reported, moves=self.stamp == "auto")
        # What was learned before is of stamps as they were.
        self.clock.usual_ns.clear()
        self._learned.clear()

    def usual_offset_ns(self, topic: str) -> int:
        """Header stamp minus log time of a topic's first messages; 0 without stamps, or where log times are taken."""
        self._learn_clocks([topic])
        return self.clock.usual_ns.get(topic, 0)

    def why_unsampled(self, topic: str, count: int) -> str | None:
        """Why none of the first few messages of a topic can be decoded, or None where some can."""
        reason = None
        for raw in islice(self.container.messages([topic]), count):
            try:
                self._decode(raw)
            except DecodeError as error:
                reason = reason or error.reason
            else:
                return None
        return reason

    def why_undecodable(self, topic: str) -> str | None:
        """Why no message of a known type can be decoded, or None where some may be."""
        for channel in self.channels_of(topic):
            # Compiling a definition takes a millisecond, and thousands of topics may share one.
            kind = channel.identity[1:]
            if not is_decodable(channel):
                continue
            if kind not in self._why_undecodable:
                self._decoder(channel)
                self._why_undecodable[kind] = self._undecodable.get(topic)
            elif (why := self._why_undecodable[kind]) is not None:
                self._undecodable[topic] = why
        return self._undecodable.get(topic)

    def ends_of(self, topic: str) -> Ends | None:
        """Tag and anchor of a topic of single ranges."""
        return ends_of_topic(topic, self._range_topics, self._anchor_ids)

    def close(self) -> None:
        """Release the file."""
        self.container.close()

    def _sound_topics(self, topics: Collection[str]) -> list[str]:
        """Those of the topics that have messages quadlog decodes, all of one type."""
        return [
            topic
            for topic in dict.fromkeys(topics)
            if any(is_decodable(channel) for channel in self.channels_of(topic)) and len(self.types_of(topic)) == 1
        ]

    def _mixed(self) -> dict[str, str]:
        """Topic -> why it is not decoded, of those that carry a type quadlog reads beside another one."""
        kinds = Counter(topic for topic, _ in {(channel.topic, channel.type_name) for channel in self.channels})
        useful = {each.topic for each in self.channels if kinds[each.topic] > 1 and is_decodable(each)}
        types = {topic: self.types_of(topic) for topic in sorted(useful)}
        several = {topic: some_of(names) for topic, names in types.items() if len(names) > 1}
        return {topic: f"the topic carries several types ({names})" for topic, names in several.items()}

    def _look(self, raws: Iterator[RawMessage]) -> Iterator[EdgeMessage]:
        """Messages that can be decoded, by topic and times alone; stamps of another clock are left out."""
        for raw in raws:
            for lag in self._lags_ns(raw):
                usual = -self.clock.usual_ns.get(raw.channel.topic, 0)
                if lag is None or abs(lag - usual) <= FAR_APART_NS:
                    yield EdgeMessage(raw.channel.topic, raw.log_time_ns, raw.log_time_ns - (lag or 0))

    def _lags_ns(self, raw: RawMessage) -> Iterator[int | None]:
        """Log time minus stamp of what a message holds, None for what has no stamp; nothing if it cannot be decoded."""
        topic, log_ns, placed_ns = raw.channel.topic, raw.log_time_ns, self.clock.one.placed_ns
        with suppress(DecodeError):
            for each in self._decode(raw):
                yield log_ns - int(placed_ns(topic, each, each.stamp_ns, log_ns)) if each.stamp_ns else None

    def _learn_clocks(self, topics: Collection[str]) -> None:
        """The usual offset of each topic's stamps from log time, from its first few stamps; computed once."""
        for topic in topics if self.stamp != "log" else ():
            if topic not in self._learned and not is_static(topic):
                self._learned.add(topic)
                raws = islice(self.container.messages([topic]), FIRST_STAMPS)
                lags = [lag for raw in raws for lag in self._lags_ns(raw) if lag is not None]
                self.clock.learn(topic, [-lag for lag in lags])
                usual = -self.clock.usual_ns.get(topic, 0)
                self._first_lags[topic] = [lag for lag in lags if abs(lag - usual) <= FAR_APART_NS] or [0]

    def _decode_or_count(self, raw: RawMessage, reading: Pass, *, points: bool = True) -> tuple[Message, ...]:
        """What a message decodes to; of failures, the reading with most is reported."""
        topic = raw.channel.topic
        try:
            decoded = self._decode(raw, points=points)
        except UnknownJoints:  # of another machine; `detect_roles` reports a topic of nothing else
            return ()
        except DecodeError as error:
            reading.failed[topic] = reading.failed.get(topic, 0) + 1
            most, why = self._failures.get(topic, (0, error.reason))
            self._failures[topic] = max(most, reading.failed[topic]), why
            return ()
        for message in decoded:
            self.clock.count_zero_stamps(topic, message, reading.zeros)
        return decoded

    def _decode(self, raw: RawMessage, *, points: bool = True) -> tuple[Message, ...]:
        decoder = self._decoder(raw.channel, points=points)
        if decoder is None:
            reason = self._undecodable.get(raw.channel.topic, f"no decoder for {raw.channel.type_name}")
            raise DecodeError(raw.channel.topic, reason)
        decoded = decoder(raw.payload)
        if decoded and isinstance(decoded[0], UwbRanges):
            return tuple(self._named(raw.channel, each) for each in decoded if isinstance(each, UwbRanges))
        return decoded

    def _decoder(self, channel: Channel, *, points: bool = True) -> Decoder | None:
        points = points or not is_cloud(channel.type_name)
        known = self._decoders.get((id(channel), points))
        if known is None:
            decoder = None
            try:
                warn = self._mended.setdefault
                decoder = decoder_for(channel, self._definitions, self.joints, points=points, warn=warn)
            except DecodeError as error:
                self._undecodable[channel.topic] = error.reason
            # The channel is kept, so its id stays its own.
            known = self._decoders[id(channel), points] = (channel, decoder)
        return known[1]

    def _named(self, channel: Channel, ranges: UwbRanges) -> UwbRanges:
        """Ranges in metres with the ids of their ends, where only the topic gives these."""
        topic = channel.topic
        if topic in self.range_units:
            ranges = in_metres(ranges, self.range_units[topic], channel.type_name)
        if ranges.tag is not None:
            return ranges
        if names_anchors(ranges):
            self._tagless.add(topic)
        return with_ends(ranges, self.ends_of(topic))
