"""Interface of all container readers: channels, raw messages in order of log time, and the losses."""

from __future__ import annotations

import heapq
from abc import abstractmethod
from collections import Counter
from collections.abc import Collection, Hashable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from quadlog.messages import Int

# Far above what recorders write (chunks of 1 to 16 MB), far below the memory of any machine.
MAX_CHUNK_BYTES = 1 << 29
MAX_INDEX_BYTES = 1 << 28
MAX_DEFINITION_BYTES = 1 << 26
MAX_NAME_BYTES = 1 << 12
MAX_TIME_NS = 2**63 - 1
JUMP_NS = 10**9
"""Log times that go back by more are a warning."""


class Damaged(Exception):
    """Bytes that do not mean what their format says. Readers turn it into a Loss.

    cause is the Loss's stable word, reason one phrase for people.
    """

    def __init__(self, reason: str, cause: str = "damaged") -> None:
        self.reason, self.cause = reason, cause
        super().__init__(reason)


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic with one type.

    type_name is normalised to ROS 2 spelling (``sensor_msgs/msg/PointCloud2``);
    protobuf and JSON schema names stay as they are (``foxglove.PointCloud``).
    message_encoding is ``ros1``, ``cdr``, ``protobuf`` or ``json``;
    schema_encoding ``ros1msg``, ``ros2msg``, ``ros2idl``, ``protobuf``, ``jsonschema`` or ``""``.
    count is what the container's own index says.
    """

    topic: str
    type_name: str
    message_encoding: str
    schema_encoding: str
    schema: bytes
    count: int = 0

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
    """Log times t_ns (N,) of messages of one channel, in any order."""

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


class Container(AbstractContextManager["Container"]):
    """One recording, open for reading.

    channels: every topic and type. span_ns: log times of the first and the last message, None when there is none or no
    index has it. resources: what is closed with it.
    """

    channels: tuple[Channel, ...] = ()
    span_ns: tuple[int, int] | None = None

    def __init__(self, path: Path, warnings: Sequence[str] = ()) -> None:
        self.path, self.resources = path, ExitStack()
        self._losses: list[Loss] = []
        self._warnings = list(warnings)

    @property
    def losses(self) -> list[Loss]:
        """What could not be read so far, each once however often it was met."""
        return list(dict.fromkeys(self._losses))

    @property
    def warnings(self) -> list[str]:
        """What is odd about what was read so far."""
        return list(dict.fromkeys(self._warnings))

    @abstractmethod
    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """Messages with start_ns <= log time < end_ns in order of log time, one at a time; memory stays flat."""

    @abstractmethod
    def log_times(self) -> Iterator[LogTimes]:
        """Log times of all messages from indexes alone, payloads unread.

        Raises Damaged, at once or on the way, where there is no index or it disagrees with itself.
        """

    @abstractmethod
    def excerpt(self, budget: Budget) -> Container | None:
        """The same recording with some of its messages, from places spread evenly; None where it fits the budget.

        Closed with the recording itself. Damage elsewhere than in these places is not found.
        """

    def close(self) -> None:
        """Release the file. Reading again afterwards is an error of the caller."""
        self.resources.close()

    def __exit__(self, *_: object) -> None:
        self.close()


def starts_back_ns(spans: Sequence[tuple[int, int]]) -> list[int]:
    """By how much each span of log times starts before those ahead of it end; 0 where it is no more than JUMP_NS."""
    begin_ns, end_ns = np.array(spans, np.int64).reshape(-1, 2).T
    back_ns = np.maximum.accumulate(np.append(0, end_ns))[:-1] - begin_ns
    return np.where(back_ns > JUMP_NS, back_ns, 0).tolist()


Identity = tuple[str, str, str, str, bytes]
"""A channel without its count."""
Key = TypeVar("Key", bound=Hashable)


def shared_channels(counted: Iterable[tuple[Key, Identity, int]]) -> dict[Key, Channel]:
    """Keys (ids in a file, or channels of its parts) to Channels; those that differ only in their count share one."""
    identities, total = dict[Key, Identity](), Counter[Identity]()
    for key, identity, count in counted:
        identities[key] = identity
        total[identity] += count
    channels = {identity: Channel(*identity, count) for identity, count in total.items()}
    return {key: channels[identity] for key, identity in identities.items()}


def merge_by_time(streams: Iterable[tuple[int, Iterator[RawMessage]]]) -> Iterator[RawMessage]:
    """Messages of all streams in order of log time; of equal times, those of the earlier stream come first.

    Each comes with a time before which it has none, and is not touched earlier: memory holds only what overlaps.
    Streams are touched in order of these times, of equal ones in the given order.
    """
    heap: list[tuple[int, int, RawMessage | None, Iterator[RawMessage]]] = [
        (start_ns, order, None, stream) for order, (start_ns, stream) in enumerate(streams)
    ]
    heapq.heapify(heap)
    while heap:
        _, order, waiting, stream = heapq.heappop(heap)
        if waiting is not None:
            yield waiting
        if not heap:
            yield from stream
            return
        # From here on the next stream may have an earlier one.
        turn_ns = heap[0][0] + (order < heap[0][1])
        for message in stream:
            if message.log_time_ns >= turn_ns:
                heapq.heappush(heap, (message.log_time_ns, order, message, stream))
                break
            yield message
