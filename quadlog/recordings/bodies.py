"""The decompressed pieces that are being read, and the next ones, which threads read ahead.

Reading, decompressing and checking release Python's lock, so they overlap with
whatever is done to the messages.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache

from quadlog.recordings.bounded import Damaged
from quadlog.recordings.pieces import Body, Piece, PieceFormat, start_of

# Bodies kept while pieces overlap in time; beyond this they are dropped and read again.
_KEPT_BYTES = 1 << 27
# What may be read again: far more than any recorder's overlap needs, in proportion to what the file is worth.
_AGAIN_BYTES, _AGAIN_RATIO = 1 << 30, 10_000
# Bodies of the file's beginning kept for the next look.
_FIRST_BYTES = 1 << 24
_AHEAD = 2
# Larger bodies are not read ahead, and are in memory alone.
_LARGE_BYTES = 1 << 25
_FREED_BYTES = 1 << 24


class FirstBodies:
    """The first few bodies that were read of a file: every look at some topic's first messages wants them again.

    A pass that comes to its end forgets them, so that of a recording in many files only one holds any.
    """

    def __init__(self) -> None:
        self._bodies: dict[int, Body] = {}
        self._room = _FIRST_BYTES

    def get(self, piece: Piece) -> Body | None:
        """The body, None where it is not one of the first."""
        return self._bodies.get(piece.offset)

    def keep(self, piece: Piece, body: Body) -> None:
        """Keep the body as long as there is room; what once had none ends the beginning."""
        if piece.offset not in self._bodies:
            self._room -= len(body.data)
            if self._room >= 0:
                self._bodies[piece.offset] = body

    def forget(self) -> None:
        """Begin anew."""
        self._bodies.clear()
        self._room = _FIRST_BYTES


class Bodies:
    """Bodies of the due pieces, which are asked for in order of their start; memory stays bounded.

    The next ones are read ahead once a second one is asked for: a look at the first messages ends before.
    """

    def __init__(self, form: PieceFormat, due: Iterable[Piece], first: FirstBodies) -> None:
        self._form, self._first = form, first
        self._begun = False
        self._bodies: OrderedDict[int, Body] = OrderedDict()
        self._bytes = 0
        self._known: set[int] = set()
        self._again_bytes = _AGAIN_BYTES
        self._waiting = deque(sorted((piece for piece in due if first.get(piece) is None), key=start_of))
        self._coming: dict[int, Future[Body | None]] = {}
        self._readers = ThreadPoolExecutor(_AHEAD, thread_name_prefix="quadlog-read")
        _let_freed_memory_be_reused()

    def get(self, piece: Piece) -> Body:
        """The body, read again when it was dropped. Raises Damaged."""
        body = self._bodies.get(piece.offset)
        if body is not None:
            self._bodies.move_to_end(piece.offset)
            return body
        body = self._arrived(piece)
        self._account(piece, body)
        while self._bodies and self._bytes + len(body.data) > _KEPT_BYTES:
            self._bytes -= len(self._bodies.popitem(last=False)[1].data)
        self._bodies[piece.offset] = body
        self._bytes += len(body.data)
        return body

    def drop(self, piece: Piece) -> None:
        """Forget the body of a piece that is read to its end."""
        body = self._bodies.pop(piece.offset, None)
        self._bytes -= 0 if body is None else len(body.data)

    def close(self) -> None:
        """Wait for what is being read: the file may be closed afterwards."""
        self._readers.shutdown(cancel_futures=True)

    def _arrived(self, piece: Piece) -> Body:
        body = self._first.get(piece)
        if body is None:
            body = self._read(piece)
            self._first.keep(piece, body)
        self._begun = True
        return body

    def _account(self, piece: Piece, body: Body) -> None:
        if piece.offset not in self._known:
            self._known.add(piece.offset)
            self._again_bytes += _AGAIN_RATIO * body.stored_bytes
            return
        self._again_bytes -= len(body.data)
        if self._again_bytes < 0:
            raise Damaged("too many large chunks overlap in time", "too-large")

    def _read(self, piece: Piece) -> Body:
        if self._waiting and self._waiting[0] is piece:
            self._waiting.popleft()
        coming = self._coming.pop(piece.offset, None)
        if self._begun:
            self._read_ahead()
        body = self._form.load(piece, _LARGE_BYTES) if coming is None else coming.result()
        if body is None:
            self._bodies.clear()
            self._bytes = 0
            body = self._form.load(piece)
        assert body is not None
        return body

    def _read_ahead(self) -> None:
        while self._waiting and len(self._coming) < _AHEAD:
            piece = self._waiting.popleft()
            self._coming[piece.offset] = self._readers.submit(self._form.load, piece, _LARGE_BYTES)


@cache
def _let_freed_memory_be_reused() -> None:
    """Keep Linux's allocator from returning every freed body to the system only to ask for the next one.

    Mapping fresh pages for each body would cost a third of decompressing it.
    glibc keeps up to twice the largest block that was freed (mallopt(3),
    M_MMAP_THRESHOLD); this one is never written, so it takes no memory itself.
    """
    bytes(_FREED_BYTES)
