"""Chunks that overlap in time: their messages in order."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from quadlog.recordings.containers.chunk_file import Body, Chunk, Rows
from quadlog.recordings.containers.container import MAX_TIME_NS, Channel, Damaged, RawMessage
from quadlog.storage.byte_source import Kept

# Data in memory of chunks that overlap in time; that of others is kept on disk.
_HELD_BYTES = 1 << 27
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


class _OnDisk(NamedTuple):
    """Data of a chunk at an offset of a temporary file."""

    file: Kept
    offset: int

    def payload(self, begin: int, end: int) -> memoryview:
        return memoryview(self.file.read(self.offset + begin, end - begin))


@dataclass(slots=True)
class _Part:
    """A chunk whose messages are not all given yet, in order of time."""

    offset: int
    rows: Rows
    data: memoryview | _OnDisk

    def take(self, horizon_ns: int | None) -> Rows:
        """The messages before the horizon, which are no longer left."""
        stop = len(self.rows) if horizon_ns is None else self.rows["t_ns"].searchsorted(horizon_ns)
        taken, self.rows = self.rows[:stop], self.rows[stop:]
        return taken


@dataclass
class Held:
    """The chunks that are open in one reading; memory stays bounded."""

    # By the time of the next message.
    _parts: list[tuple[int, int, _Part]] = field(default_factory=list)
    _held_bytes: int = 0
    _disk: Kept = field(default_factory=Kept)

    def take(self, chunk: Chunk, body: Body, rows: Rows) -> Damaged | None:
        """A chunk and its wanted messages, in order of time; what is wrong where it does not fit."""
        if not len(rows):
            return None
        data: memoryview | _OnDisk = body.data
        if self._held_bytes and self._held_bytes + len(body.data) > _HELD_BYTES:
            offset = self._disk.append(body.data)
            if offset is None:
                return Damaged("too many large chunks overlap in time", "too-large")
            data = _OnDisk(self._disk, offset)
        else:
            self._held_bytes += len(body.data)
        self._wait(_Part(chunk.offset, rows, data))
        return None

    def messages(self, horizon_ns: int | None, channel_of: Mapping[int, Channel]) -> Iterator[RawMessage]:
        """Those before the horizon, at which the next chunk begins; of equal times in order of the file."""
        due: list[_Part] = []
        while self._parts and (horizon_ns is None or self._parts[0][0] < horizon_ns):
            due.append(heapq.heappop(self._parts)[2])
        if not due:
            return
        due.sort(key=lambda part: part.offset)
        taken = [part.take(horizon_ns) for part in due]
        rows, source = np.concatenate(taken), np.repeat(np.arange(len(due)), list(map(len, taken)))
        if len(due) > 1:
            order = np.argsort(rows["t_ns"], kind="stable")
            rows, source = rows[order], source[order]
        for at in range(0, len(rows), _BLOCK):
            block = slice(at, at + _BLOCK)
            columns = rows[block].view(np.int64).reshape(-1, 4).T.tolist()
            for index, t_ns, number, begin, end in zip(source[block].tolist(), *columns, strict=True):
                data = due[index].data
                payload = data[begin:end] if isinstance(data, memoryview) else data.payload(begin, end)
                yield RawMessage(channel_of[number], t_ns, payload)
        for part in due:
            if len(part.rows):
                self._wait(part)
            elif isinstance(part.data, memoryview):
                self._held_bytes -= len(part.data)

    def _wait(self, part: _Part) -> None:
        heapq.heappush(self._parts, (int(part.rows["t_ns"][0]), part.offset, part))
