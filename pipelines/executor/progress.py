"""Progress of replays and batches: messages of workers, the clock of stages, and the memory they take."""

from __future__ import annotations

import os
import resource
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

_send: Callable[[Any], None] | None = None
_name: str | None = None


def tell(message: Any) -> None:
    """Send a message from a worker to the command that waits for it; dropped where there is none, or none any more."""
    if _send is not None:
        with suppress(OSError):
            _send(message)


def send_to(send: Callable[[Any], None] | None, name: str | None = None) -> None:
    """From now on `tell` calls this function. name: of this worker, for `worker_name`."""
    global _send, _name
    _send, _name = send, name


def worker_name() -> str:
    """Name of this worker: the address of a Dask worker, else host and process id."""
    return _name or f"{os.uname().nodename}:{os.getpid()}"


class Progress:
    """What is shown while a recording is replayed; here, nothing."""

    def begin(self, stage: str, total: int | None) -> None:
        """A stage starts; total is the number of its steps, None when unknown."""

    def advance(self, recorded_s: float | None = None) -> None:
        """One step of the current stage is done; recorded_s is how far into the recording it reached."""

    def say(self, text: str) -> None:
        """A choice or a warning, one line."""

    def note(self, text: str) -> None:
        """A detail, one line."""
        self.say(text)

    def compiled(self, kernels: int) -> None:
        """So many compiled functions have been made; the time that takes counts as no stage's."""


Silent = Progress


@dataclass(slots=True)
class StartUp:
    """Seconds that this process has loaded libraries, compiled, or waited for a process that does: no stage's time."""

    seconds: float = 0.0

    @contextmanager
    def loading(self) -> Iterator[None]:
        """The block imports, or loads what compiled code needs."""
        began_s = time.perf_counter()
        try:
            yield
        finally:
            self.seconds += time.perf_counter() - began_s


start_up = StartUp()


def working_s() -> float:
    """A clock that stands while this process starts up."""
    return time.perf_counter() - start_up.seconds


class StageClock:
    """Seconds spent in each stage, without compilation, and the process's peak memory when it ended.

    Stages may interleave: a scan is read, then filtered, then the next one is
    read; each stage gets its own share of the time.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.peak_memory_mb: dict[str, float] = {}

    @contextmanager
    def stage(self, *names: str) -> Iterator[Callable[[str], None]]:
        """Count the time of the block towards stages: call the yielded function with the one that has just worked.

        What is left at the end counts towards the first. Memory is looked at once, so that laps may be short.
        """
        last_s = working_s()

        def lap(name: str) -> None:
            nonlocal last_s
            now_s = working_s()
            self.seconds[name] = self.seconds.get(name, 0.0) + now_s - last_s
            last_s = now_s

        try:
            yield lap
        finally:
            lap(names[0])
            for name in names:
                self.seconds.setdefault(name, 0.0)
                self.peak_memory_mb[name] = peak_memory_mb()


# On Linux; rusage would include the memory of the parent that this process was copied from.
_STATUS, _FORGET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


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


TOLD_EVERY_S = 0.5


@dataclass(slots=True)
class BatchCounts:
    """Recordings of a batch: all, those that have ended, and those of them that failed."""

    recordings: int
    done: int = 0
    failed: int = 0


SAID_EVERY_S = 30.0


class BatchLines(Progress):
    """What the command line shows while recordings are replayed: a line for each finished one, as in a log file.

    As a context, also a line on where it is every SAID_EVERY_S.
    """

    def __init__(self, say: Callable[[str], None], notes: bool = True) -> None:
        """notes: whether details are shown."""
        self._say, self._notes, self._tally, self._where, self._steps = say, notes, BatchCounts(0), "", 0
        self._ended = threading.Event()

    def __enter__(self) -> Self:
        threading.Thread(target=self._go_on_saying, daemon=True).start()
        return self

    def __exit__(self, kind: object, value: BaseException | None, trace: object) -> None:
        self._ended.set()

    def _go_on_saying(self) -> None:
        began_s = time.monotonic()
        while not self._ended.wait(SAID_EVERY_S):
            self._say(f"{self._where.format(self._steps)}, {time.monotonic() - began_s:.0f} s")

    def begin(self, stage: str, total: int | None) -> None:
        """The stage for the next line."""
        self._where, self._steps = f"{stage} {{}}{f'/{total}' if total else ''}", 0

    def advance(self, recorded_s: float | None = None) -> None:
        """One more step."""
        self._steps += 1

    def note(self, text: str) -> None:
        """A detail, if they are shown."""
        if self._notes:
            self.say(text)

    def say(self, text: str) -> None:
        """One line."""
        self._say(text)

    def expect(self, tally: BatchCounts) -> None:
        """A batch starts. The tally is updated by its owner while it runs."""
        self._tally = tally

    def hear(self, step: Mapping[str, Any]) -> None:
        """A message of TaskProgress from a worker. A line for each would be thousands."""
        self._where = (
            f"{self._tally.done} of {self._tally.recordings} done, {step['run']} {step['stage']} {step['steps']}"
        )

    def finish(self, run: str, words: str) -> None:
        """The recording of this run folder has ended. words: `done`, or the reason."""
        self._say(f"[{self._tally.done}/{self._tally.recordings}] {run}: {words}")


class TaskProgress(Progress):
    """Progress of a replay in a batch: sends its position every TOLD_EVERY_S at most, and keeps warnings."""

    def __init__(self, number: int, run: str) -> None:
        """number: of the recording in the batch; run: the name of its folder."""
        self.warnings: list[str] = []
        self._who = {"number": number, "run": run, "worker": worker_name()}
        self._stage, self._total, self._steps = "", 0, 0
        self._began_s = self._told_s = 0.0

    def begin(self, stage: str, total: int | None) -> None:
        """Send the new stage at once."""
        self._stage, self._total, self._steps = stage, total or 0, 0
        self._began_s = working_s()
        self._tell(None)

    def advance(self, recorded_s: float | None = None) -> None:
        """Count a step; send a message unless the last one is recent."""
        self._steps += 1
        if time.monotonic() - self._told_s >= TOLD_EVERY_S:
            self._tell(None if recorded_s is None else recorded_s / max(working_s() - self._began_s, 1e-9))

    def say(self, text: str) -> None:
        """Keep a warning. Choices are in the run's record and are not kept."""
        if text.startswith("warning: "):
            self.warnings.append(text)

    def _tell(self, factor: float | None) -> None:
        self._told_s = time.monotonic()
        where = {"stage": self._stage, "steps": self._steps, "total": self._total, "realtime_factor": factor}
        tell(self._who | where | {"peak_memory_mb": peak_memory_mb()})
