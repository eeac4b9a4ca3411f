"""The SHA-256 of a file from the bytes that somebody reads anyway, so that they are read once."""

from __future__ import annotations

import hashlib
import threading

from quadlog.storage.byte_ranges import LocalBytes

GAP_BYTES = 1 << 20
"""Gaps between two stretches, such as message indexes, are read for the digest up to this length."""
MOST_WAITING_BYTES = 1 << 26
_BLOCK_BYTES = 1 << 20


class SharedDigest:
    """Takes stretches of a file from any thread, in about the file's order; what is missing is read at the end."""

    def __init__(self, file: LocalBytes) -> None:
        self._file, self._sha256, self._at = file, hashlib.sha256(), 0
        self._waiting: dict[int, bytes] = {}
        self._taking, self._hashing = threading.Lock(), threading.Lock()
        file.watcher = self._take

    def finish(self) -> str:
        """The digest of the whole file, in hexadecimal digits. Raises OSError."""
        self._file.watcher = None
        with self._hashing:
            self._hash_ready()
            self._waiting.clear()
            while block := self._file.read(self._at, _BLOCK_BYTES):
                self._update(block)
        return self._sha256.hexdigest()

    def _take(self, offset: int, data: bytes) -> None:
        with self._taking:
            if offset + len(data) <= self._at or sum(map(len, self._waiting.values())) > MOST_WAITING_BYTES:
                return
            self._waiting[offset] = data
        # Whoever hashes takes along what others bring meanwhile: they need not wait for it.
        if self._hashing.acquire(blocking=False):
            try:
                self._hash_ready()
            finally:
                self._hashing.release()

    def _hash_ready(self) -> None:
        while True:
            with self._taking:
                offset = min(self._waiting, default=None)
                if offset is None or offset > self._at + GAP_BYTES:
                    return
                data = self._waiting.pop(offset)
            if offset > self._at:
                self._update(self._file.read_unwatched(self._at, offset - self._at))
            if offset <= self._at:
                self._update(memoryview(data)[self._at - offset :])

    def _update(self, data: bytes | memoryview) -> None:
        self._sha256.update(data)
        self._at += len(data)
