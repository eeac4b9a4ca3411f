"""Progress messages of a replay, sent from the process it runs in to a listener; lost without one."""

from __future__ import annotations

import os
import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from socket import gethostname
from typing import Any, Protocol

Listener = Callable[[Any], None]
"""Called with each message of a task, from any thread."""

_listener: Listener | None = None
_name: str | None = None


def tell(message: Any) -> None:
    """Send a message of JSON values to the listener; without one it is dropped."""
    if _listener is not None:
        _listener(message)


def worker_name() -> str:
    """Name of this worker: the address of a Dask worker, else host and process id."""
    return _name or f"{gethostname()}:{os.getpid()}"


@contextmanager
def told_to(listener: Listener | None, name: str | None = None) -> Iterator[None]:
    """While the body runs, `tell` calls this function."""
    global _listener, _name
    before = _listener, _name
    _listener, _name = listener, name
    try:
        yield
    finally:
        _listener, _name = before


# On Linux; rusage would include the memory of the parent that this process was copied from.
_STATUS, _FORGET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


class Progress(Protocol):
    """What is shown while a recording is replayed."""

    def begin(self, stage: str, total: int | None) -> None:
        """A stage starts; total is the number of its steps, None when unknown."""

    def advance(self, recorded_s: float | None = None) -> None:
        """One step of the current stage is done; recorded_s is how far into the recording it reached."""

    def say(self, text: str) -> None:
        """A choice or a warning, one line."""


class Silent:
    """Shows nothing."""

    def begin(self, stage: str, total: int | None) -> None:
        """Nothing to show."""

    def advance(self, recorded_s: float | None = None) -> None:
        """Nothing to show."""

    def say(self, text: str) -> None:
        """Nothing to show."""


class Kept(Silent):
    """Keeps the lines, for the process that has the terminal."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, text: str) -> None:
        """Keep one line."""
        self.lines.append(text)


class StageClock:
    """Seconds spent in each stage and the process's peak memory when it ended.

    Stages may interleave: a scan is read, then filtered, then the next one is
    read; each stage gets its own share of the time.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.peak_memory_mb: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time of the block towards a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
            self.peak_memory_mb[name] = peak_memory_mb()

    @contextmanager
    def laps(self, *names: str) -> Iterator[Callable[[str], None]]:
        """Split the time of the block between stages: call the yielded function with the stage that has just worked.

        What is left at the end counts towards the first stage. Memory is looked at once, so that laps may be short.
        """
        last = time.perf_counter()

        def lap(name: str) -> None:
            nonlocal last
            now = time.perf_counter()
            self.seconds[name] = self.seconds.get(name, 0.0) + now - last
            last = now

        try:
            yield lap
        finally:
            lap(names[0])
            for name in names:
                self.seconds.setdefault(name, 0.0)
                self.peak_memory_mb[name] = peak_memory_mb()


def peak_memory_mb() -> float:
    """The largest resident size this process has had, in MB, or since `forget_peak_memory` where Linux runs."""
    try:
        for line in _STATUS.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) * 1024 / 1e6
    except OSError:
        pass
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    bytes_per_unit = 1 if sys.platform == "darwin" else 1024
    return peak * bytes_per_unit / 1e6


def forget_peak_memory() -> None:
    """What follows in this process has a peak of its own, where the system can do that."""
    with suppress(OSError):
        _FORGET.write_text("5")
