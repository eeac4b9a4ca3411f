"""Interface of all container readers: channels, raw messages in order of log time, and the losses."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol, Self, TypeVar

from quadlog.messages import Int


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic with one type.

    type_name is normalised to ROS 2 spelling (``sensor_msgs/msg/PointCloud2``);
    protobuf and JSON schema names stay as they are (``foxglove.PointCloud``).
    message_encoding is ``ros1``, ``cdr``, ``protobuf`` or ``json``;
    schema_encoding ``ros1msg``, ``ros2msg``, ``ros2idl``, ``protobuf``, ``jsonschema`` or ``""``.
    count is what the container's own index says, None where it says nothing.
    """

    topic: str
    type_name: str
    message_encoding: str
    schema_encoding: str
    schema: bytes
    count: int | None = None

    @property
    def identity(self) -> Identity:
        """All but its count."""
        return self.topic, self.type_name, self.message_encoding, self.schema_encoding, self.schema


class RawMessage(NamedTuple):
    """One message before decoding; payload is bytes-like and valid as long as it is referenced."""

    channel: Channel
    log_time_ns: int
    payload: bytes | memoryview


class LogTimes(NamedTuple):
    """Log times t_ns (N,) of messages of one channel; batches that follow have none before floor_ns."""

    floor_ns: int
    channel: Channel
    t_ns: Int


class Budget(NamedTuple):
    """How much of a recording an excerpt may hold; at least one place is read, however large."""

    places: int
    stored_bytes: int
    messages: int

    def shared(self, among: int) -> Budget:
        """The part of each of several files."""
        return Budget(max(self.places // among, 1), self.stored_bytes // among, self.messages // among)


# Reading and decoding so much takes about 0.2 s.
EXCERPT = Budget(places=16, stored_bytes=1 << 24, messages=1 << 14)
# Tags are located from it, which takes seconds to begin with.
UWB_EXCERPT = Budget(places=64, stored_bytes=1 << 26, messages=1 << 16)
NOTHING = Budget(0, 0, 0)


def places_within(budget: Budget, places: int, stored_bytes: int, messages: int) -> int | None:
    """How many of a recording's places fit a budget, given the size of all of them; None where it is not exceeded."""
    if stored_bytes <= budget.stored_bytes and messages <= budget.messages and budget.places:
        return None
    fitting = min(budget.stored_bytes * places // max(stored_bytes, 1), budget.messages * places // max(messages, 1))
    return min(max(fitting, 1), budget.places, places)


def spread(among: int, count: int) -> list[int]:
    """Evenly spread indices below `among`, the first and the last one included."""
    return [index * (among - 1) // max(count - 1, 1) for index in range(count)]


@dataclass(frozen=True, slots=True)
class Loss:
    """Something that was in the recording, or should have been, and could not be read. Exit code 3.

    cause is a stable word (``truncated``, ``crc``, ``missing-split``, ``count``, ``decode``, ...);
    detail one line for people: what was lost, from when to when.
    """

    cause: str
    detail: str
    topic: str | None = None
    count: int | None = None


class Container(Protocol):
    """One recording, open for reading. `losses` and `warnings` grow while it is read."""

    path: Path
    losses: list[Loss]

    @property
    def warnings(self) -> list[str]:
        """What a user should know, each a line."""
        ...

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Every topic and type, known without reading the messages where the format allows it."""
        ...

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Log times of the first and the last message, None when there is none or no index has it."""
        ...

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """Messages with start_ns <= log time < end_ns in order of log time, one at a time; memory stays flat."""
        ...

    def log_times(self) -> Iterator[LogTimes]:
        """Log times of all messages from indexes alone, payloads unread.

        Raises Damaged, at once or on the way, where there is no index or it disagrees with itself.
        """
        ...

    def excerpt(self, budget: Budget) -> Container | None:
        """The same recording with some of its messages, from places spread evenly; None where it fits the budget.

        Closed with the recording itself. Damage elsewhere than in these places is not found.
        """
        ...

    def release(self) -> None:
        """Give file descriptors back until something is read again: a recording may have thousands of files."""
        ...

    def close(self) -> None:
        """Release the file. Reading again afterwards is an error of the caller."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...


class ClosedOnExit:
    """A context manager that closes itself."""

    close: Callable[[], None]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


Identity = tuple[str, str, str, str, bytes]
"""A channel without its count."""
Key = TypeVar("Key", bound=Hashable)


def shared_channels(
    identities: Iterable[tuple[Key, Identity]], count_of: Callable[[Key], int | None]
) -> dict[Key, Channel]:
    """Keys (ids in a file, or channels of its parts) to Channels; those that differ only in their count share one.

    Its count is the sum, None where one of them is.
    """
    alike: dict[Identity, list[Key]] = {}
    for key, identity in identities:
        alike.setdefault(identity, []).append(key)
    shared: dict[Key, Channel] = {}
    for identity, keys in alike.items():
        counts = [count_of(key) for key in keys]
        known = [count for count in counts if count is not None]
        channel = Channel(*identity, count=sum(known) if len(known) == len(counts) else None)
        shared.update(dict.fromkeys(keys, channel))
    return shared


class Source(Protocol):
    """Messages in order of log time. next_ns: there is none before; None once there is none left.

    A source may keep a message back, but not the bytes of a whole chunk.
    """

    next_ns: int | None

    def until(self, last_ns: int | None) -> Iterator[RawMessage]:
        """The messages that are left with log time <= last_ns, or all; afterwards next_ns is beyond it."""
        ...


def merge_by_time(sources: Iterable[Source]) -> Iterator[RawMessage]:
    """Messages of all sources in order of log time; of equal times, those of the earlier source come first.

    A source is opened when its first message is due, so memory holds only sources that overlap in time.
    """
    heap: list[tuple[int, int, Source]] = []
    for order, source in enumerate(sources):
        if source.next_ns is not None:
            heap.append((source.next_ns, order, source))
    heapq.heapify(heap)
    while heap:
        _, order, source = heapq.heappop(heap)
        if not heap:
            yield from source.until(None)
            return
        due_ns, due_order = heap[0][:2]
        yield from source.until(due_ns if order < due_order else due_ns - 1)
        if source.next_ns is not None:
            heapq.heappush(heap, (source.next_ns, order, source))


class Stream:
    """The messages of an iterator (Source), which is made when the time comes before which it has none."""

    def __init__(self, start_ns: int, open_stream: Callable[[], Iterator[RawMessage]]) -> None:
        self.next_ns: int | None = start_ns
        self._open_stream = open_stream
        self._messages: Iterator[RawMessage] | None = None
        self._waiting: RawMessage | None = None

    def until(self, last_ns: int | None) -> Iterator[RawMessage]:
        if self._messages is None:
            self._messages = self._open_stream()
        if self._waiting is not None:
            waiting, self._waiting = self._waiting, None
            yield waiting
        for message in self._messages:
            if last_ns is not None and message.log_time_ns > last_ns:
                self._waiting, self.next_ns = message, message.log_time_ns
                return
            yield message
        self.next_ns = None
