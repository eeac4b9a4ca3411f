"""The decompressed pieces that are being read, and the next ones, which threads read ahead.

Reading, decompressing and checking release Python's lock, so they overlap with
whatever is done to the messages.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor

from quadlog.recordings.pieces import Piece, PieceFormat

# Bodies kept while pieces overlap in time; beyond this they are dropped and read again.
_KEPT_BYTES = 1 << 27
_AHEAD = 2
_LARGE_BYTES = 1 << 24


class Bodies:
    """Bodies of the due pieces, which are asked for in order of their start; memory stays bounded."""

    def __init__(self, form: PieceFormat, due: Iterable[Piece]) -> None:
        self._form = form
        self._bodies: OrderedDict[int, memoryview] = OrderedDict()
        self._bytes = 0
        self._waiting = deque(sorted(due, key=lambda piece: piece.start_ns))
        self._coming: dict[int, Future[memoryview]] = {}
        self._readers = ThreadPoolExecutor(_AHEAD, thread_name_prefix="quadlog-read")
        _let_freed_memory_be_reused()

    def get(self, piece: Piece) -> memoryview:
        """The body, read again when it was dropped. Raises Damaged."""
        body = self._bodies.get(piece.offset)
        if body is not None:
            self._bodies.move_to_end(piece.offset)
            return body
        body = self._arrived(piece)
        while self._bodies and self._bytes + len(body) > _KEPT_BYTES:
            self._bytes -= len(self._bodies.popitem(last=False)[1])
        self._bodies[piece.offset] = body
        self._bytes += len(body)
        return body

    def drop(self, piece: Piece) -> None:
        """Forget the body of a piece that is read to its end."""
        self._bytes -= len(self._bodies.pop(piece.offset, b""))

    def close(self) -> None:
        """Wait for what is being read: the file may be closed afterwards."""
        self._readers.shutdown(cancel_futures=True)

    def _arrived(self, piece: Piece) -> memoryview:
        self._read_ahead()
        coming = self._coming.pop(piece.offset, None)
        self._read_ahead()
        return self._form.load(piece) if coming is None else coming.result()

    def _read_ahead(self) -> None:
        while self._waiting and len(self._coming) < _AHEAD:
            piece = self._waiting.popleft()
            self._coming[piece.offset] = self._readers.submit(self._form.load, piece)


def _let_freed_memory_be_reused() -> None:
    """Keep Linux's allocator from returning every freed body to the system only to ask for the next one.

    Mapping fresh pages for each body would cost a third of decompressing it.
    glibc keeps up to twice the largest block that was freed (mallopt(3),
    M_MMAP_THRESHOLD); this one is never written, so it takes no memory itself.
    """
    bytes(_LARGE_BYTES)
