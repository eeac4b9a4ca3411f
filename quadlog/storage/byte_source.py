"""Any stretch of a file's bytes, by offset: there is no position, so that several threads can read one file."""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Protocol
from weakref import finalize

from quadlog.errors import FileError

Span = tuple[int, int]
"""Offset and length."""


class ByteSource(Protocol):
    """A file of known size, on this machine or on a server; safe to use from several threads."""

    size: int

    def read(self, offset: int, length: int) -> bytes:
        """The bytes from offset on, fewer where the file ends.

        Raises OSError where the disk fails; StorageFailed and StorageChanged where a server does, which is no damage.
        """

    def read_each(self, spans: Sequence[Span]) -> list[bytes]:
        """The same for small stretches that lie far apart."""

    def check_unchanged(self) -> None:
        """Raises StorageChanged where a server has another file now than when it was opened."""

    def close(self) -> None:
        """Release it; nothing may be reading."""


class LocalBytes:
    """An open file of this machine."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb", buffering=0)
        self.size = os.fstat(self._file.fileno()).st_size

    def read(self, offset: int, length: int) -> bytes:
        handle = self._file.fileno()
        data = os.pread(handle, length, offset)
        while 0 < len(data) < length and (more := os.pread(handle, length - len(data), offset + len(data))):
            data += more
        return data

    def read_each(self, spans: Sequence[Span]) -> list[bytes]:
        return [self.read(offset, length) for offset, length in spans]

    def check_unchanged(self) -> None:
        pass

    def close(self) -> None:
        self._file.close()


class Kept:
    """A nameless temporary file of data that takes long to get, while half of the disk's room is left.

    Safe to use from several threads.
    """

    def __init__(self) -> None:
        self._handle: int | None = None
        self._places: dict[Hashable, Span] = {}
        self._end = self._room = 0
        self._lock = threading.Lock()

    def append(self, data: bytes | memoryview) -> int | None:
        """Keep it: its offset, None where there is no room."""
        with self._lock, suppress(OSError):  # the disk is full
            if self._handle is None:
                file = tempfile.TemporaryFile(prefix="quadlog-")  # noqa: SIM115
                finalize(self, file.close)
                self._handle, self._room = file.fileno(), shutil.disk_usage(tempfile.gettempdir()).free // 2
            if self._end + len(data) <= self._room and os.pwrite(self._handle, data, self._end) == len(data):
                self._end += len(data)
                return self._end - len(data)
        return None

    def read(self, offset: int, length: int) -> bytes:
        """What was kept there. Raises FileError where this machine's disk fails."""
        with suppress(OSError):
            if self._handle is not None and len(data := os.pread(self._handle, length, offset)) == length:
                return data
        raise FileError(tempfile.gettempdir(), "the disk does not give back what was written to it")

    def data(self, key: Hashable, get: Callable[[], bytes | memoryview]) -> bytes | memoryview:
        """What `get` gives, or gave before for this key. Raises what it raises."""
        with suppress(FileError):
            if key in self._places:
                return self.read(*self._places[key])
        data = get()
        if (offset := self.append(data)) is not None:
            self._places[key] = offset, len(data)
        return data
