"""Sources that each give messages in order of log time, merged without opening one before its turn."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

from quadlog.recordings.container import RawMessage


class Source(Protocol):
    """Messages in order of log time. next_ns: there is none before; None once there is none left.

    Whether a source keeps a message back is its own affair: what waits must not hold the bytes of a whole chunk.
    """

    next_ns: int | None

    def until(self, last_ns: int | None) -> Iterator[RawMessage]:
        """The messages that are left with log time <= last_ns, or all; afterwards next_ns is beyond it."""
        ...


def merge_by_time(sources: Iterable[Source]) -> Iterator[RawMessage]:
    """Messages of all sources in order of log time; of equal times, those of the earlier source come first.

    A source is asked for its first message when its time has come, so memory holds only sources that overlap.
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
        """See Source."""
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
