"""Compilation at the first start, when numba's cache is empty: announced, timed, and shared with a second process.

Compiling holds a lock within one process, so a second core helps only another process, whose results are then found in
the cache.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from multiprocessing import parent_process
from threading import Event, Thread
from typing import IO, Any

from numba.core import event

from quadlog.pipelines.executor.machine import cores

SAID = "compiling for the first time on this machine, 3 to 20 s depending on the log; later starts use the cache"
LONGEST_S = 600.0
"""The other process is not waited for longer than this."""


class _Clock(event.Listener):
    """Seconds that this process has compiled, and what to call when it compiles next. Compilations nest."""

    def __init__(self) -> None:
        self.seconds, self.on_next = 0.0, None
        self._depth, self._began_s = 0, 0.0

    on_next: Callable[[], None] | None

    def on_start(self, event: Any) -> None:
        self._depth += 1
        if self._depth == 1:
            self._began_s = time.perf_counter()
            call, self.on_next = self.on_next, None
            if call is not None:
                call()

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._began_s


_clock = _Clock()
event.register("numba:compile", _clock)


def compiling_s() -> float:
    """Seconds that this process has compiled, or waited for another one that did, so far."""
    return _clock.seconds


@contextmanager
def on_first_compilation(call: Callable[[], None]) -> Iterator[None]:
    """Call a function once, when the body compiles anything for the first time."""
    _clock.on_next = call
    try:
        yield
    finally:
        _clock.on_next = None


@contextmanager
def compile_with_help(
    elsewhere: Sequence[str], shared: Sequence[str], say: Callable[[str], None]
) -> Iterator[Callable[[str], None]]:
    """Say so when the body first compiles, and let a second process compile some parts of the code meanwhile.

    elsewhere: command of the second process, which compiles the parts named as arguments, in that order, and prints
    each name when it is done. It is started with those of `shared` that have not begun, except by a batch's workers,
    which share the cores already, and is stopped with the body. To be called before a part begins: the yielded
    function, which waits for the second process if it has the part; that counts as compiling.
    """
    begun: set[str] = set()
    done: dict[str, Event] = {}

    def start() -> None:
        say(SAID)
        names = [name for name in shared if name not in begun]
        if names and cores() > 1 and parent_process() is None:
            done.update({name: Event() for name in names})
            stack.enter_context(_second_process([*elsewhere, *names], done))

    def before(name: str) -> None:
        begun.add(name)
        if name in done:
            began_s = time.perf_counter()
            done[name].wait(LONGEST_S)
            _clock.seconds += time.perf_counter() - began_s

    with ExitStack() as stack, on_first_compilation(start):
        yield before


@contextmanager
def _second_process(command: Sequence[str], done: dict[str, Event]) -> Iterator[None]:
    """Run the command during the block, and mark each name that it prints as done; all of them when it ends."""
    streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command, text=True, **streams)  # type: ignore[call-overload]

    def follow(lines: IO[str]) -> None:
        with lines:
            for line in lines:
                if line.strip() in done:
                    done[line.strip()].set()
        for each in done.values():
            each.set()

    reading = Thread(target=follow, args=(process.stdout,), daemon=True)
    reading.start()
    try:
        yield
    finally:
        process.kill()
        process.wait()
        reading.join()


def python(*arguments: str) -> list[str]:
    """Command of this Python interpreter that does not import from the working folder."""
    return [sys.executable, "-P", *arguments]
