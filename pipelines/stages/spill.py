"""What a map needs of every scan, kept from the one pass over the recording until positions are known."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from tempfile import SpooledTemporaryFile
from types import TracebackType
from typing import Self

from quadlog.results.files import part_prefix

MOST_IN_MEMORY_BYTES = 16 << 20
_LENGTH = struct.Struct("<Q")


class Spill:
    """Records of bytes, read back in the order in which they were written.

    Up to a bound they stay in memory, then they go to a file in `folder` that has no name: it is gone with the process,
    however that ends. Where the system knows no such files it has the name of an unfinished file for an instant.
    Raises OSError when the disk is full.
    """

    def __init__(self, folder: Path, most_in_memory_bytes: int = MOST_IN_MEMORY_BYTES) -> None:
        own = part_prefix(os.getpid())
        self._file = SpooledTemporaryFile(most_in_memory_bytes, dir=str(folder), prefix=own, suffix=".part")  # noqa: SIM115
        self._count = 0

    def append(self, *parts: bytes) -> None:
        """One record, made of parts."""
        self._file.write(_LENGTH.pack(sum(map(len, parts))))
        for part in parts:
            self._file.write(part)
        self._count += 1

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[bytes]:
        self._file.seek(0)
        for _ in range(self._count):
            (length,) = _LENGTH.unpack(self._file.read(_LENGTH.size))
            yield self._file.read(length)
        self._file.seek(0, os.SEEK_END)

    def close(self) -> None:
        """Give the room back."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
