"""One long recording, classified by several processes: whoever is free takes the next window, and all come in order.

This process takes its turns as the others do, and begins alone while they
start. As soon as anything in the recording is odd, nobody goes on: how often
and where first, only one pass through all of it can tell.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from quadlog.errors import QuadlogError, WorkerDied
from quadlog.pipelines.engine.local_pool import LocalPool
from quadlog.pipelines.stages.parcel import Parcel, unpack
from quadlog.pipelines.stages.scans import ScanTally
from quadlog.pipelines.stages.window_helper import Answer, answer, begin_helper, help_with, is_ready
from quadlog.pipelines.stages.window_shares import Shares
from quadlog.pipelines.stages.windows import Scan, Seen, Source, Window, WindowReader
from quadlog.recordings.clock import Clock

GIVEN = 4
"""Windows on their way for each helper, so that none waits while this process is at one of its own."""
HELD = 2
"""Windows that this process may have classified before their turn."""


class Odd(Exception):
    """There may be more to tell of the recording than its windows do."""


class _Given(NamedTuple):
    window: Window
    answer: Future[Answer]
    held: bool = False


@contextmanager
def shared_scans(source: Source, shares: Shares, known: Clock, say: Callable[[str], None]) -> Iterator[SharedScans]:
    """The scans of a source whose recording is cut into windows; helpers and their parcels are gone afterwards.

    known: the clock of the recording as it was read before. Raises as opening the recording does.
    """
    with TemporaryDirectory(prefix="quadlog-") as folder, source.open() as recording:
        pool = LocalPool(shares.helpers, begin_helper, (source, Path(folder), shares.most_scans))
        try:
            yield SharedScans(shares, WindowReader(source, recording), pool, known, say)
        finally:
            pool.terminate_workers()


class SharedScans:
    """The scans of all windows in order; `tally` is theirs once they are read."""

    def __init__(
        self, shares: Shares, reader: WindowReader, pool: LocalPool, known: Clock, say: Callable[[str], None]
    ) -> None:
        self.tally = ScanTally()
        self._shares, self._reader, self._pool, self._known, self._say = shares, reader, pool, known, say
        self._todo = deque(shares.windows)
        self._given: deque[_Given] = deque()
        self._helpers = [pool.submit(is_ready) for _ in range(shares.helpers)]
        self._clocks: list[Clock] = []
        self._n_clouds = 0

    def read(self) -> Iterator[Scan]:
        """One at a time. Raises Odd, at the latest behind the last one."""
        try:
            while self._todo or self._given:
                self._give()
                if not self._given:
                    yield from self._classify_now(self._todo.popleft())
                elif self._given[0].answer.done() or not self._work_ahead():
                    yield from self._next()
        except QuadlogError as error:
            raise Odd from error
        if self._shares.n_clouds not in (None, self._n_clouds) or not self._known.agrees_with(self._clocks):
            raise Odd

    def _give(self) -> None:
        """See that every helper that is ready has windows to go on with."""
        for each in self._helpers:
            if each.done() and (error := each.exception()) is not None:
                self._do_without_helpers(error)
                break
        ready = sum(each.done() for each in self._helpers)
        while self._todo and len(self._given) < GIVEN * ready:
            window = self._todo.popleft()
            self._given.append(_Given(window, self._pool.submit(help_with, window)))

    def _work_ahead(self) -> bool:
        """Classify the first window that nobody has begun, and hold its scans; False where there is none, or enough."""
        if sum(each.held for each in self._given) == HELD:
            return False
        for place, (window, waiting, _) in enumerate(self._given):
            if waiting.cancel():
                own: Future[Answer] = Future()
                own.set_result(answer(self._reader, window, self._shares.most_scans))
                self._given[place] = _Given(window, own, held=True)
                return True
        return False

    def _next(self) -> Iterator[Scan]:
        window, waiting, _ = self._given.popleft()
        scans: list[Scan] | None = None
        try:
            packed, seen = waiting.result().scans, waiting.result().seen
            scans = unpack(packed) if isinstance(packed, Parcel) else packed
        except WorkerDied as error:
            self._do_without_helpers(error)
        except Exception as error:
            raise Odd from error
        if scans is None:
            yield from self._classify_now(window)
            return
        self._take_in(seen)
        yield from scans

    def _do_without_helpers(self, error: BaseException) -> None:
        """Give them nothing more; what they have begun is still welcome."""
        self._say(f"{error}; this one goes on alone")
        self._helpers.clear()

    def _classify_now(self, window: Window) -> Iterator[Scan]:
        yield from self._reader.read(window)
        self._take_in(self._reader.seen())

    def _take_in(self, seen: Seen) -> None:
        if not seen.sound:
            raise Odd
        self.tally.add(seen.tally)
        self._clocks.append(seen.clock)
        self._n_clouds += seen.n_clouds
