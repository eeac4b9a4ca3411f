"""Stretches of an object behind a URL, kept in a file without a name, so that two passes transfer them once.

The file is sparse: it takes the room of what was fetched. Beyond half of the
disk's free room blocks are fetched again instead of kept.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

from quadlog.errors import StorageFailed
from quadlog.storage.byte_source import Span
from quadlog.storage.remote_object import RemoteObject
from quadlog.storage.urls import redacted

# Small beside a chunk of a recording (about 1 MB): a time window's edges cost little more than they must.
BLOCK_BYTES = 1 << 16
_AT_A_TIME = 16


class RemoteBytes:
    """An object that is read by range (ByteSource); safe to use from several threads."""

    def __init__(self, remote: RemoteObject, size: int) -> None:
        self.size = size
        self._remote = remote
        self._kept = tempfile.TemporaryFile(prefix="quadlog-")  # noqa: SIM115 - closed by close()
        self._room = shutil.disk_usage(tempfile.gettempdir()).free // 2
        self._blocks: set[int] = set()
        self._coming: set[int] = set()
        self._change = threading.Condition()

    def read(self, offset: int, length: int) -> bytes:
        """See ByteSource."""
        end = min(offset + length, self.size)
        if offset >= end:
            return b""
        first, last = offset // BLOCK_BYTES, (end - 1) // BLOCK_BYTES
        fetched = self._fetch_missing(first, last)
        parts = [fetched[block] if block in fetched else self._from_file(block) for block in range(first, last + 1)]
        data = b"".join(parts)
        begin = offset - first * BLOCK_BYTES
        return data[begin : begin + end - offset]

    def read_each(self, spans: Sequence[Span]) -> list[bytes]:
        """See ByteSource; nothing is kept."""
        ends = [(offset, min(offset + length, self.size)) for offset, length in spans]
        with ThreadPoolExecutor(_AT_A_TIME) as threads:
            return list(threads.map(lambda span: self._remote.fetch(*span) if span[0] < span[1] else b"", ends))

    def release(self) -> None:
        """See ByteSource: what was fetched is kept."""

    def close(self) -> None:
        """Give the room back."""
        self._kept.close()

    def _fetch_missing(self, first: int, last: int) -> dict[int, bytes]:
        """Blocks that had to be fetched; afterwards the file has all others. What another thread fetches is awaited."""
        fetched: dict[int, bytes] = {}
        while True:
            with self._change:
                lacking = [b for b in range(first, last + 1) if b not in self._blocks and b not in fetched]
                todo = [block for block in lacking if block not in self._coming]
                if not lacking:
                    return fetched
                if not todo:
                    self._change.wait()
                    continue
                self._coming.update(todo)
            try:
                for begin, behind in _runs(todo):
                    fetched.update(self._fetch(begin, behind))
            finally:
                with self._change:
                    self._coming.difference_update(todo)
                    self._change.notify_all()

    def _fetch(self, begin: int, behind: int) -> dict[int, bytes]:
        """Neighbouring blocks by one request, kept as long as there is room."""
        start, end = begin * BLOCK_BYTES, min(behind * BLOCK_BYTES, self.size)
        data = self._remote.fetch(start, end)
        if len(data) != end - start:
            raise StorageFailed(
                redacted(self._remote.url), f"{len(data)} bytes came where {end - start} were asked for"
            )
        if self._keep(start, data):
            with self._change:
                self._blocks.update(range(begin, behind))
        return {
            begin + number: data[place : place + BLOCK_BYTES]
            for number, place in enumerate(range(0, len(data), BLOCK_BYTES))
        }

    def _keep(self, start: int, data: bytes) -> bool:
        with self._change:
            if len(data) > self._room:
                return False
            self._room -= len(data)
        try:
            written = os.pwrite(self._kept.fileno(), data, start)
        except OSError:  # somebody else filled the disk: nothing more is kept
            written = 0
        if written < len(data):
            self._room = 0
        return written == len(data)

    def _from_file(self, block: int) -> bytes:
        length = min(BLOCK_BYTES, self.size - block * BLOCK_BYTES)
        try:
            data = os.pread(self._kept.fileno(), length, block * BLOCK_BYTES)
        except OSError:  # this machine's disk fails: no damage of a recording that lies elsewhere
            data = b""
        return data if len(data) == length else self._fetch(block, block + 1)[block]


def _runs(blocks: list[int]) -> Iterator[tuple[int, int]]:
    """Neighbours among sorted blocks together: the first of each run, and the one behind its last."""
    begin = blocks[0]
    for before, block in zip(blocks, [*blocks[1:], -1], strict=True):
        if block != before + 1:
            yield begin, before + 1
            begin = block
