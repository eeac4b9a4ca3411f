"""Compilation at the first start, when numba's cache is empty: announced and timed."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from numba.core import event
from numba.core.registry import cpu_target

from quadlog.config.schema import Config
from quadlog.open3d import import_open3d
from quadlog.pipelines.executor.progress import Progress, start_up

SAID = "compiling for the first time on this machine, 3 to 20 s depending on the log; later starts use the cache"


class _Clock(event.Listener):
    """Adds what this process compiles to its start-up, and what to call at the next time and each time. They nest."""

    began_s, depth, kernels = 0.0, 0, 0
    on_next: Callable[[], None] | None = None
    on_each: Callable[[int], None] | None = None

    def on_start(self, event: Any) -> None:
        self.depth += 1
        if self.depth == 1:
            self.began_s = time.perf_counter()
            call, self.on_next = self.on_next, None
            if call is not None:
                call()

    def on_end(self, event: Any) -> None:
        self.depth -= 1
        if self.depth == 0:
            start_up.seconds += time.perf_counter() - self.began_s
            self.kernels += 1
            if self.on_each is not None:
                self.on_each(self.kernels)


_clock = _Clock()
event.register("numba:compile", _clock)  # type: ignore[no-untyped-call]


@cache
def load_compiler() -> None:
    """What numba would load at the first call of any compiled function, cached or not: a third of a second."""
    cpu_target.typing_context.refresh()  # type: ignore[no-untyped-call]
    cpu_target.target_context.refresh()  # type: ignore[no-untyped-call]


@contextmanager
def on_first_compilation(call: Callable[[], None]) -> Iterator[None]:
    """Call a function once, when the body compiles anything for the first time."""
    _clock.on_next = call
    try:
        yield
    finally:
        _clock.on_next = None


@contextmanager
def compilation(config: Config, progress: Progress) -> Iterator[Callable[[str], None]]:
    """Say so when the body first compiles.

    Yields a function to be called before each stage: it loads what the stage's compiled code needs, and keeps what
    lives by then out of the search for garbage.
    """

    def start() -> None:
        progress.say(SAID)
        _clock.kernels, _clock.on_each = 0, progress.compiled

    def before(name: str) -> None:
        gc.freeze()  # what is loaded by now lives on; searching it for garbage takes a tenth of a second each time
        with start_up.loading():
            if name not in ("ingest", "position"):
                load_compiler()
            if name == "filter" and config.lidar.method == "paper":
                import_open3d()

    with on_first_compilation(start):
        try:
            yield before
        finally:
            _clock.on_each = None
            gc.unfreeze()
