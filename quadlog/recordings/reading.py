"""One reading of a recording: small messages are gathered and become rows, clouds are read as they come."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from quadlog.errors import DecodeError
from quadlog.messages import Batch, Int, Timed, Transforms, UwbRanges
from quadlog.recordings.clocks.clock import Mask
from quadlog.recordings.clocks.clock_offsets import stream_name
from quadlog.recordings.containers.container import Channel, RawMessage
from quadlog.recordings.decoders.payload import Payload
from quadlog.recordings.decoders.rows import Part
from quadlog.recordings.decoding import CloudReader, RowReader
from quadlog.recordings.tf_tree import is_static

if TYPE_CHECKING:
    from quadlog.recordings.recording import Recording

MOST_WAITING, MOST_WAITING_BYTES = 4096, 1 << 20
"""Small messages of a channel that are decoded at once."""


@dataclass(slots=True)
class _Waiting:
    """Small messages of a channel that wait until there are enough to be decoded at once: order, log time, payload."""

    channel: Channel
    reader: RowReader | CloudReader | None
    messages: list[tuple[int, int, bytes]] = field(default_factory=list)
    size: int = 0


class Pass:
    """One reading of some topics: messages go in as they were logged, rows and clouds come out.

    points: whether clouds have them. timed: whether times are on the recording's clock, and stray stamps left out, or
    log times. counted: whether failures are losses, and stamps of 0 warnings. decoded: how many messages could be
    decoded so far; why: the reason of the first that could not. log_ns: when the last cloud was logged.
    """

    def __init__(
        self,
        recording: Recording,
        start_ns: int | None = None,
        end_ns: int | None = None,
        *,
        points: bool = False,
        timed: bool = True,
        counted: bool = True,
    ) -> None:
        self.start_ns, self.end_ns = start_ns, end_ns
        self._recording, self._points, self._timed, self._counted = recording, points, timed, counted
        self._waiting: dict[int, _Waiting] = {}
        self._failed, self._zeros = Counter[str](), Counter[str]()
        self.decoded = self.log_ns = 0
        self.why: str | None = None

    def over(self, raws: Iterable[RawMessage]) -> Iterator[Iterator[Batch | Timed]]:
        """What messages become, in parts of one topic; at the end all that waits."""
        for order, (channel, log_ns, raw) in enumerate(raws):
            waiting = self._waiting.get(id(channel)) or self._begin(channel)
            if isinstance(waiting.reader, CloudReader):
                yield self._cloud(channel.topic, waiting.reader, log_ns, raw)
            elif waiting.reader is not None:
                payload = bytes(raw)  # copied, so that no chunk is kept for it
                waiting.messages.append((order, log_ns, payload))
                waiting.size += len(payload)
                if waiting.size >= MOST_WAITING_BYTES or len(waiting.messages) >= MOST_WAITING:
                    yield self._rows(channel, waiting)
        for waiting in self._waiting.values():
            if waiting.messages:
                yield self._rows(waiting.channel, waiting)

    def _begin(self, channel: Channel) -> _Waiting:
        self._waiting[id(channel)] = _Waiting(channel, self._recording.reader(channel))
        return self._waiting[id(channel)]

    def _cloud(self, topic: str, reader: CloudReader, log_ns: int, payload: Payload) -> Iterator[Timed]:
        self.log_ns = log_ns
        try:
            cloud = reader.decode(payload, self._points)
        except DecodeError as error:
            self._fail(topic, 1, error.reason)
            return
        if cloud is None:
            return
        self.decoded += 1
        stamp_ns = None if cloud.stamp_ns is None else np.array([cloud.stamp_ns])
        t_ns, kept = self._times(topic, stamp_ns, np.array([log_ns]))
        if kept[0]:
            yield Timed(int(t_ns[0]), topic, cloud)

    def _rows(self, channel: Channel, waiting: _Waiting) -> Iterator[Batch]:
        assert isinstance(waiting.reader, RowReader)
        *numbers, payloads = zip(*waiting.messages, strict=True)
        orders, log_ns = np.array(numbers, np.int64)
        waiting.messages, waiting.size = [], 0
        failed, first = 0, (len(payloads), "")
        for decoded in waiting.reader.read(payloads):
            failed += decoded.failed
            first = min(first, (int(decoded.which[0]), decoded.why)) if decoded.why else first
            self.decoded += len(decoded.which) - decoded.failed if decoded.parts else 0
            for part in decoded.parts:
                yield from self._batch(channel, part, orders[decoded.which], log_ns[decoded.which])
        self._fail(channel.topic, failed, first[1])

    def _batch(self, channel: Channel, part: Part, orders: Int, log_ns: Int) -> Iterator[Batch]:
        rows, stamp_ns, topic, frames = part.rows, part.stamp_ns, channel.topic, part.frames or ("", "")
        if part.of is not None:
            orders, log_ns = orders[part.of], log_ns[part.of]
            stamp_ns = None if stamp_ns is None else stamp_ns[part.of]
        if part.kind is UwbRanges:
            self._recording.name_ranges(channel, rows)
        stream = stream_name(topic, *frames) if part.kind is Transforms else ""
        rows["order"] = orders
        rows["t_ns"], kept = self._times(topic, stamp_ns, log_ns, stream)
        batch = Batch(part.kind, topic, rows, log_ns, stamp_ns, *frames, part.unmeasured)
        if kept.any():
            yield batch if kept.all() else picked(batch, kept)

    def _times(self, topic: str, stamp_ns: Int | None, log_ns: Int, stream: str = "") -> tuple[Int, Mask]:
        """Times (N,), and which of them are no strays and within the window. Static transforms hold at all times."""
        clock, kept = self._recording.clock, np.ones(len(log_ns), np.bool_)
        t_ns, static = log_ns, is_static(topic)
        if self._counted and stamp_ns is not None and not static and clock.stamp != "log":
            self._zeros[topic] += int((stamp_ns == 0).sum())
            clock.zero_stamps[topic] = max(clock.zero_stamps.get(topic, 0), self._zeros[topic])
        if self._timed and static:
            t_ns = log_ns if stamp_ns is None or clock.stamp == "log" else np.where(stamp_ns == 0, log_ns, stamp_ns)
        elif self._timed:
            t_ns, kept = clock.times_ns(topic, stamp_ns, log_ns, stream)
        if self.start_ns is not None:
            kept = kept & (t_ns >= self.start_ns)
        if self.end_ns is not None:
            kept = kept & (t_ns < self.end_ns)
        return t_ns, kept

    def _fail(self, topic: str, count: int, why: str) -> None:
        self.why = self.why or why or None
        if count and self._counted:
            self._failed[topic] += count
            self._recording.count_failures(topic, self._failed[topic], why)


def picked(batch: Batch, rows: Mask) -> Batch:
    """The rows where a mask (N,) holds."""
    stamp_ns = None if batch.stamp_ns is None else batch.stamp_ns[rows]
    return batch._replace(rows=batch.rows[rows], log_ns=batch.log_ns[rows], stamp_ns=stamp_ns)


def stamps_of(each: Batch | Timed) -> tuple[str, Int, Int]:
    """The stream (a topic or a transform), log times (N,), header stamps (N,), 0 without; of a reading on log times."""
    if isinstance(each, Timed):
        return each.topic, np.array([each.t_ns]), np.array([each.message.stamp_ns or 0])
    named = each.kind is Transforms
    stream = stream_name(each.topic, each.frame_id, each.child_frame_id) if named else each.topic
    stamp_ns = np.zeros(len(each.log_ns), np.int64) if each.stamp_ns is None else each.stamp_ns
    return stream, each.log_ns, stamp_ns
