"""Any stretch of a file's bytes, wherever the file lies; without a file position, so that threads can read ahead."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Lock
from typing import BinaryIO, Protocol

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

    def release(self) -> None:
        """Give the file descriptor back until something is read again."""
        ...

    def close(self) -> None:
        """Release it."""
        ...


class LocalBytes:
    """A file of this machine (ByteSource); safe to use from several threads."""

    watcher: Callable[[int, bytes], None] | None = None
    """Called with the offset and the bytes of whatever is read, by whichever thread reads it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = Lock()
        self._reading = 0
        self._is_unneeded = self._is_closed = False
        self._file: BinaryIO | None = path.open("rb", buffering=0)
        status = os.fstat(self._file.fileno())
        self.size, self._identity = status.st_size, (status.st_dev, status.st_ino)

    def read(self, offset: int, length: int) -> bytes:
        data = self.read_unwatched(offset, length)
        if self.watcher is not None:
            self.watcher(offset, data)
        return data

    def read_unwatched(self, offset: int, length: int) -> bytes:
        """The same, of which the watcher is not told."""
        with self._lock:
            handle = self._opened()
            self._reading += 1
        try:
            data = os.pread(handle, length, offset)
            while 0 < len(data) < length and (more := os.pread(handle, length - len(data), offset + len(data))):
                data += more
            return data
        finally:
            with self._lock:
                self._reading -= 1
                self._close_if_unneeded()

    def read_each(self, spans: Sequence[Span]) -> list[bytes]:
        """See ByteSource."""
        return [self.read(offset, length) for offset, length in spans]

    def release(self) -> None:
        """See ByteSource."""
        with self._lock:
            self._is_unneeded = True
            self._close_if_unneeded()

    def close(self) -> None:
        """Release it for good."""
        self._is_closed = True
        self.release()

    def _opened(self) -> int:
        if self._is_closed:
            raise ValueError("a closed file is read")
        self._is_unneeded = False
        if self._file is None:
            file = self._path.open("rb", buffering=0)
            status = os.fstat(file.fileno())
            if (status.st_dev, status.st_ino) != self._identity:
                file.close()
                raise OSError(errno.ESTALE, "it was replaced while it was read", str(self._path))
            self._file = file
        return self._file.fileno()

    def _close_if_unneeded(self) -> None:
        # Another thread may be in the middle of reading.
        if self._is_unneeded and not self._reading and self._file is not None:
            self._file.close()
            self._file = None
