"""Compilation at the first start, when numba's cache is empty: announced, and shared with a second process.

Compiling holds a lock within one process, so a second core helps only another process, whose results are then found in
the cache.
"""

from __future__ import annotations

import gc
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from multiprocessing import parent_process
from threading import Event, Thread
from types import TracebackType
from typing import IO, Any, Self

from numba.core import event

from quadlog.pipelines.executor.machine import cores

SAID = "compiling for the first time on this machine, 3 to 20 s depending on the log; later starts use the cache"
LONGEST_S = 600.0
"""The other process is not waited for longer than this."""


class _OnFirst(event.Listener):
    """Calls a function when the first compilation starts."""

    def __init__(self, call: Callable[[], None]) -> None:
        self._call: Callable[[], None] | None = call

    def on_start(self, event: Any) -> None:
        call, self._call = self._call, None
        if call is not None:
            call()

    def on_end(self, event: Any) -> None:
        """Nothing to do."""


@contextmanager
def on_first_compilation(call: Callable[[], None]) -> Iterator[None]:
    """Call a function once, when the body compiles anything for the first time."""
    with event.install_listener("numba:compile", _OnFirst(call)):
        yield


class Compilation:
    """Compile parts of the code, each by running it once before it is needed (`before`).

    parts: a function for each name. elsewhere: command of a second process that compiles the parts named as arguments,
    in that order, and prints each name when it is done. It starts when something is missing in the cache, with those of
    `shared` that have not begun, and is stopped with the context. If it fails, its parts are compiled here. say: called
    once when something is missing.
    """

    def __init__(
        self,
        parts: Mapping[str, Callable[[], object]],
        shared: Sequence[str],
        elsewhere: Sequence[str],
        say: Callable[[str], None],
    ) -> None:
        self.seconds = 0.0
        self._parts, self._shared, self._elsewhere, self._say = parts, shared, elsewhere, say
        self._begun: set[str] = set()
        self._done_elsewhere: dict[str, Event] = {}
        self._context = ExitStack()

    def __enter__(self) -> Self:
        self._context.enter_context(on_first_compilation(self._start))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._context.close()

    def before(self, *names: str) -> None:
        """Compile the named parts, or wait for the other process to; adds the time to `seconds`."""
        started = time.perf_counter()
        for name in names:
            if name in self._parts and name not in self._begun:
                self._begun.add(name)
                if name in self._done_elsewhere:
                    self._done_elsewhere[name].wait(LONGEST_S)
                with _uncollected():
                    self._parts[name]()
        self.seconds += time.perf_counter() - started

    def _start(self) -> None:
        self._say(SAID)
        names = [name for name in self._shared if name in self._parts and name not in self._begun]
        if not names or cores() < 2 or parent_process() is not None:  # a batch's workers share the cores already
            return
        process = subprocess.Popen(  # noqa: S603 (constants)
            [*self._elsewhere, *names],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self._done_elsewhere = {name: Event() for name in names}
        reading = Thread(target=_follow, args=(process.stdout, self._done_elsewhere), daemon=True)
        reading.start()
        self._context.callback(_stop, process, reading)


@contextmanager
def _uncollected() -> Iterator[None]:
    """Without the garbage collector, which takes a tenth of the time: compiling builds millions of objects."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _follow(lines: IO[str], done: Mapping[str, Event]) -> None:
    """Mark each printed name as done, and all of them when the process ends."""
    with lines:
        for line in lines:
            if line.strip() in done:
                done[line.strip()].set()
    for each in done.values():
        each.set()


def _stop(process: subprocess.Popen[str], reading: Thread) -> None:
    process.kill()
    process.wait()
    reading.join()


def python(*arguments: str) -> list[str]:
    """Command of this Python interpreter that does not import from the working folder."""
    return [sys.executable, "-P", *arguments]
