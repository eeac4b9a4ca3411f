"""Chunks that overlap in time: their messages in order."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from quadlog.recordings.containers.chunk_file import Body, Chunk, Rows
from quadlog.recordings.containers.container import MAX_TIME_NS, Channel, Damaged, RawMessage

# Data kept of chunks that overlap in time; beyond this they are dropped and read again.
_KEPT_BYTES = 1 << 27
# What may be read again: far more than any recorder's overlap needs, in proportion to what the file is worth.
_AGAIN_BYTES, _AGAIN_RATIO = 1 << 30, 10_000
# Messages whose times and places are Python objects at once.
_BLOCK = 1024


def chosen(rows: Rows, wanted: Mapping[int, Channel], start_ns: int | None, end_ns: int | None) -> Rows:
    """Those of these channels with start_ns <= log time < end_ns, in order of log time."""
    keep = np.fromiter(map(wanted.__contains__, rows["channel"].tolist()), np.bool_, len(rows))
    if start_ns is not None:
        keep &= rows["t_ns"] >= min(start_ns, MAX_TIME_NS)
    if end_ns is not None and end_ns <= MAX_TIME_NS:
        keep &= rows["t_ns"] < end_ns
    rows = rows[keep]
    t_ns = rows["t_ns"]
    return rows[np.argsort(t_ns, kind="stable")] if np.any(t_ns[1:] < t_ns[:-1]) else rows


@dataclass(slots=True)
class Part:
    """A chunk whose messages are not all given yet, in order of time."""

    chunk: Chunk
    rows: Rows
    lost: bool = False

    def take(self, horizon_ns: int | None) -> Rows:
        """The messages before the horizon, which are no longer left."""
        stop = len(self.rows) if horizon_ns is None else self.rows["t_ns"].searchsorted(horizon_ns)
        taken, self.rows = self.rows[:stop], self.rows[stop:]
        return taken


@dataclass
class Held:
    """The chunks that are open in one reading; memory stays bounded: data that was dropped is loaded again.

    load: the body of a chunk, or what is wrong with it. lose: record a damaged chunk and how many messages are missing.
    """

    load: Callable[[Chunk], Body | Damaged | None]
    lose: Callable[[Chunk, Damaged, int], None]
    # By the time of the next message.
    parts: list[tuple[int, int, Part]] = field(default_factory=list)
    data: dict[int, memoryview] = field(default_factory=dict)
    held_bytes: int = 0
    again_bytes: int = field(default_factory=lambda: _AGAIN_BYTES)

    def take(self, chunk: Chunk, body: Body, rows: Rows) -> None:
        """A chunk and its wanted messages, in order of time."""
        self.again_bytes += _AGAIN_RATIO * body.stored_bytes
        if len(rows):
            self._keep(chunk.offset, body.data)
            self._wait(Part(chunk, rows))

    def messages(self, horizon_ns: int | None, channel_of: Mapping[int, Channel]) -> Iterator[RawMessage]:
        """Those before the horizon, at which the next chunk begins; of equal times in order of the file."""
        due: list[Part] = []
        while self.parts and (horizon_ns is None or self.parts[0][0] < horizon_ns):
            due.append(heapq.heappop(self.parts)[2])
        if not due:
            return
        due.sort(key=lambda part: part.chunk.offset)
        taken = [part.take(horizon_ns) for part in due]
        rows, source = np.concatenate(taken), np.repeat(np.arange(len(due)), list(map(len, taken)))
        if len(due) > 1:
            order = np.argsort(rows["t_ns"], kind="stable")
            rows, source = rows[order], source[order]
        current, data = -1, None
        for at in range(0, len(rows), _BLOCK):
            block = slice(at, at + _BLOCK)
            columns = rows[block].view(np.int64).reshape(-1, 4).T.tolist()
            places = range(at, at + len(columns[0]))
            for place, index, t_ns, number, begin, end in zip(places, source[block].tolist(), *columns, strict=True):
                if index != current:
                    current, data = index, self._data(due, index, source[place:])
                if data is not None:
                    yield RawMessage(channel_of[number], t_ns, data[begin:end])
        for part in due:
            if len(part.rows) and not part.lost:
                self._wait(part)
            else:
                self._drop(part.chunk.offset)

    def _wait(self, part: Part) -> None:
        heapq.heappush(self.parts, (int(part.rows["t_ns"][0]), part.chunk.offset, part))

    def _data(self, due: list[Part], index: int, sources: NDArray[np.int64]) -> memoryview | None:
        """The data of a due part, read again if it was dropped. None where that fails: what is left of it is lost.

        sources: of which part each message is that is still to be given.
        """
        part = due[index]
        offset = part.chunk.offset
        if part.lost or offset in self.data:
            return None if part.lost else self.data[offset]
        body = self.load(part.chunk)
        if isinstance(body, Body):
            self.again_bytes -= len(body.data)
            if self.again_bytes >= 0:
                self._keep(offset, body.data)
                return body.data
            body = Damaged("too many large chunks overlap in time", "too-large")
        part.lost = True
        self.lose(
            part.chunk, body or Damaged("it cannot be read again"), len(part.rows) + int((sources == index).sum())
        )
        return None

    def _keep(self, offset: int, data: memoryview) -> None:
        while self.data and self.held_bytes + len(data) > _KEPT_BYTES:
            self._drop(next(iter(self.data)))
        self.data[offset] = data
        self.held_bytes += len(data)

    def _drop(self, offset: int) -> None:
        self.held_bytes -= len(self.data.pop(offset, b""))
