"""Any stretch of a file's bytes, wherever the file lies; without a file position, so that threads can read ahead."""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from quadlog.errors import StorageFailed
from quadlog.storage.remote_object import RemoteObject
from quadlog.storage.urls import redacted

Span = tuple[int, int]
"""Offset and length."""
SPARE_BYTES, _SPARE_RECORDS = 1 << 32, 1 << 16
"""What all chunks of a file may hold beyond what their size is worth."""


class Allowance:
    """So much for all places of a file together; a place that is read again counts once."""

    def __init__(self, most: int) -> None:
        self._left, self._taken = most, dict[int, int]()

    def left(self, place: int) -> int:
        """What the place may take, with what it took before."""
        return self._left + self._taken.get(place, 0)

    def take(self, place: int, amount: int) -> bool:
        """Whether there is so much for the place."""
        if self._taken.get(place, 0) < amount <= self.left(place):
            self._left, self._taken[place] = self.left(place) - amount, amount
        return amount <= self.left(place)


class LocalBytes:
    """An open file of this machine, of known size; safe to use from several threads."""

    def __init__(self, path: Path) -> None:
        self.spare_bytes, self.spare_records = Allowance(SPARE_BYTES), Allowance(_SPARE_RECORDS)
        self._file = path.open("rb", buffering=0)
        self.size = os.fstat(self._file.fileno()).st_size

    def read(self, offset: int, length: int) -> bytes:
        """So many bytes from offset on, fewer where the file ends. Raises OSError where the disk fails."""
        handle = self._file.fileno()
        data = os.pread(handle, length, offset)
        while 0 < len(data) < length and (more := os.pread(handle, length - len(data), offset + len(data))):
            data += more
        return data

    def read_each(self, spans: Sequence[Span]) -> list[bytes]:
        """Small stretches that lie far apart."""
        return [self.read(offset, length) for offset, length in spans]

    def close(self) -> None:
        """Release it; nothing may be reading."""
        self._file.close()


# Small beside a chunk of a recording (about 1 MB): a time window's edges cost little more than they must.
BLOCK_BYTES = 1 << 16
_AT_A_TIME = 16


class RemoteBytes:
    """An object behind a URL that is read by range, as LocalBytes; safe to use from several threads."""

    def __init__(self, remote: RemoteObject, size: int) -> None:
        self.spare_bytes, self.spare_records = Allowance(SPARE_BYTES), Allowance(_SPARE_RECORDS)
        self.size = size
        self._remote = remote
        self._kept = tempfile.TemporaryFile(prefix="quadlog-")  # noqa: SIM115 - closed by close()
        self._room = shutil.disk_usage(tempfile.gettempdir()).free // 2
        self._blocks: set[int] = set()
        self._coming: set[int] = set()
        self._change = threading.Condition()

    def read(self, offset: int, length: int) -> bytes:
        """The same. Raises StorageFailed and StorageChanged, which are no damage of the file."""
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
        """The same: no more than these is fetched, several at a time, and nothing is kept."""
        ends = [(offset, min(offset + length, self.size)) for offset, length in spans]
        with ThreadPoolExecutor(_AT_A_TIME) as threads:
            return list(threads.map(lambda span: self._remote.fetch(*span) if span[0] < span[1] else b"", ends))

    def close(self) -> None:
        self._kept.close()

    def _fetch_missing(self, first: int, last: int) -> dict[int, bytes]:
        """Fetch the blocks that are neither kept nor being fetched by another thread, and wait for the latter."""
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
            raise StorageFailed(redacted(self._remote.url), f"{len(data)} bytes received, {end - start} requested")
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
        except OSError:  # the disk is full: nothing more is kept
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


ByteSource = LocalBytes | RemoteBytes


def _runs(blocks: list[int]) -> Iterator[tuple[int, int]]:
    """Neighbours among sorted blocks together: the first of each run, and the one behind its last."""
    begin = blocks[0]
    for before, block in zip(blocks, [*blocks[1:], -1], strict=True):
        if block != before + 1:
            yield begin, before + 1
            begin = block
