"""Progress of a batch: the messages of its workers, and how much of the whole is done."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from quadlog.pipelines.executor.progress import Progress, peak_memory_mb, tell, worker_name

TOLD_EVERY_S = 0.5


@dataclass(slots=True)
class BatchCounts:
    """Recordings of a batch: all, those that have ended, and those of them that failed."""

    recordings: int
    done: int = 0
    failed: int = 0


class BatchLines(Progress):
    """What the command line shows while recordings are replayed: a line for each that ends, as for a log file."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say, self._tally = say, BatchCounts(0)

    def say(self, text: str) -> None:
        """One line."""
        self._say(text)

    def expect(self, tally: BatchCounts) -> None:
        """A batch starts. The tally is updated by its owner while it runs."""
        self._tally = tally

    def hear(self, step: Mapping[str, Any]) -> None:
        """A message of TaskProgress from a worker. A line for each would be thousands."""

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
        self._began_s = time.monotonic()
        self._tell(self._began_s, None)

    def advance(self, recorded_s: float | None = None) -> None:
        """Count a step; send a message unless the last one is recent."""
        self._steps += 1
        if (now_s := time.monotonic()) - self._told_s >= TOLD_EVERY_S:
            self._tell(now_s, None if recorded_s is None else recorded_s / max(now_s - self._began_s, 1e-9))

    def say(self, text: str) -> None:
        """Keep a warning. Choices are in the run's record and are not kept."""
        if text.startswith("warning: "):
            self.warnings.append(text)

    def _tell(self, now_s: float, factor: float | None) -> None:
        self._told_s = now_s
        where = {"stage": self._stage, "steps": self._steps, "total": self._total, "realtime_factor": factor}
        tell(self._who | where | {"peak_memory_mb": peak_memory_mb()})
