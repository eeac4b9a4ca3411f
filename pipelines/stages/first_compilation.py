"""The very first start, when compiled code is not in the cache yet: it is said, and shared with another process.

Compiling holds a lock within one process, so a second core only helps
another one; what that one compiled is found in the cache afterwards.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event

from quadlog.pipelines.engine.cores import cores

SAID = "compiling for the first time on this machine, which takes some seconds; later starts find it in the cache"
LONGEST_S = 600.0
"""Another process that takes longer hangs, and is not waited for."""


class _OnFirst(event.Listener):
    """Calls a function when the first compilation starts."""

    def __init__(self, call: Callable[[], None]) -> None:
        self._call: Callable[[], None] | None = call

    def on_start(self, event: Any) -> None:
        call, self._call = self._call, None
        if call is not None:
            call()

    def on_end(self, event: Any) -> None:
        """Nobody waits for it."""


@contextmanager
def compiled_elsewhere(command: list[str] | None, say: Callable[[str], None]) -> Iterator[None]:
    """While the body runs; if it has anything to compile, that is said, and a command is run on another core.

    Once the body is done, so is the command, if there is one. Its failure is no failure: what
    it has not compiled is compiled here when it is needed.
    """
    running: list[subprocess.Popen[bytes]] = []

    def begin() -> None:
        say(SAID)
        if command is not None and cores() > 1:
            nothing = subprocess.DEVNULL
            started = subprocess.Popen(command, stdin=nothing, stdout=nothing, stderr=nothing)  # noqa: S603 (constants)
            running.append(started)

    try:
        with event.install_listener("numba:compile", _OnFirst(begin)):
            yield
        for each in running:
            each.wait(LONGEST_S)
    except subprocess.TimeoutExpired:
        pass
    finally:
        for each in running:
            each.kill()
            each.wait()


def python(*arguments: str) -> list[str]:
    """Arguments to this same Python, for which the folder it is started in holds no modules."""
    return [sys.executable, "-P", *arguments]
