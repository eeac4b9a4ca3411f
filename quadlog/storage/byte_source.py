"""Any stretch of a file's bytes, by offset: there is no position, so that several threads can read one file."""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterable, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from weakref import finalize

from quadlog.errors import FileError, TooLarge
from quadlog.storage.atomic_write import writing

Span = tuple[int, int]
"""Offset and length."""


class ByteSource(ABC):
    """A file of known size, on this machine or on a server; safe to use from several threads."""

    size: int

    @abstractmethod
    def read(self, offset: int, length: int) -> bytes:
        """The bytes from offset on, fewer where the file ends.

        Raises OSError where the disk fails; StorageFailed and StorageChanged where a server does, which is no damage.
        """

    def read_each(self, spans: Sequence[Span]) -> list[bytes]:
        """The same for small stretches that lie far apart."""
        return [self.read(offset, length) for offset, length in spans]

    def check_unchanged(self) -> None:  # noqa: B027 - on this machine no file is replaced under an open one
        """Raises StorageChanged where a server has another file now than when it was opened."""

    def close(self) -> None:  # noqa: B027 - of what is read by requests nothing is open
        """Release it; nothing may be reading."""


class LocalBytes(ByteSource):
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

    def close(self) -> None:
        self._file.close()


def fill(target: Path, blocks: Iterable[bytes], what: object, size: int = 0) -> int:
    """Write blocks into a new file, at most half of what is free: the rest of the machine lives there too.

    Returns how many bytes. Raises TooLarge, before the first where the size is known; CannotWrite on a full disk.
    """
    room, written = shutil.disk_usage(target.parent).free // 2, 0
    with target.open("xb", buffering=0) as file:
        for block in chain([b""], blocks):
            written += len(block)
            if max(written, size) > room:
                limit = "at most half of what is free there; TMPDIR names another folder"
                raise TooLarge(f"{what}: bytes to write to {target.parent} ({limit})", max(written, size), room)
            with writing(target):
                file.write(block)
    return written


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
