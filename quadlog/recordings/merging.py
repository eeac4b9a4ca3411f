"""Sources that each give messages in order of log time, merged without opening one before its turn."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator

from quadlog.recordings.container import RawMessage

Source = tuple[int, Callable[[], Iterator[RawMessage]]]


def merge_by_time(sources: Iterable[Source]) -> Iterator[RawMessage]:
    """Messages of all sources in order of log time; of equal times, those of the earlier source come first.

    A source is the time before which it has nothing (ns), and a function that
    opens it; it is opened when that time comes and dropped when it is
    exhausted, so memory holds only sources that overlap.
    """
    heap: list[tuple[int, int, RawMessage | None, Iterator[RawMessage]]] = [
        (start_ns, order, None, _opened_late(open_source)) for order, (start_ns, open_source) in enumerate(sources)
    ]
    heapq.heapify(heap)
    while heap:
        _, order, message, iterator = heapq.heappop(heap)
        if message is not None:
            yield message
        if not heap:
            yield from iterator
            return
        next_due = heap[0][:2]
        for message in iterator:
            if (message.log_time_ns, order) > next_due:
                heapq.heappush(heap, (message.log_time_ns, order, message, iterator))
                break
            yield message


def _opened_late(open_source: Callable[[], Iterator[RawMessage]]) -> Iterator[RawMessage]:
    yield from open_source()
