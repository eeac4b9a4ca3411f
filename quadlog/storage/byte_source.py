"""Any stretch of a file's bytes, wherever the file lies; without a file position, so that threads can read ahead."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

Span = tuple[int, int]
"""Offset and length."""


class ByteSource(Protocol):
    """An open file of known size."""

    size: int

    def read(self, offset: int, length: int) -> bytes:
        """So many bytes from offset on, fewer where the file ends. Raises OSError where the disk fails.

        What lies behind a URL raises StorageFailed and StorageChanged instead: that is no damage of the file.
        """
        ...

    def read_each(self, spans: Sequence[Span]) -> list[bytes]:
        """Small stretches that lie far apart: of a remote file no more than these is fetched, several at a time."""
        ...

    def close(self) -> None:
        """Release it."""
        ...


class LocalBytes:
    """A file of this machine (ByteSource)."""

    watcher: Callable[[int, bytes], None] | None = None
    """Called with the offset and the bytes of whatever is read, by whichever thread reads it."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self.size = os.fstat(self._file.fileno()).st_size
        self.close = self._file.close

    def read(self, offset: int, length: int) -> bytes:
        data = self.read_unwatched(offset, length)
        if self.watcher is not None:
            self.watcher(offset, data)
        return data

    def read_unwatched(self, offset: int, length: int) -> bytes:
        """The same, of which the watcher is not told."""
        handle = self._file.fileno()
        data = os.pread(handle, length, offset)
        while 0 < len(data) < length and (more := os.pread(handle, length - len(data), offset + len(data))):
            data += more
        return data

    def read_each(self, spans: Sequence[Span]) -> list[bytes]:
        return [self.read(offset, length) for offset, length in spans]
