"""Progress on stderr, of one replay and of a batch: bars in a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from threading import Lock
from types import TracebackType
from typing import TYPE_CHECKING, Any

import click

from quadlog.errors import printable
from quadlog.pipelines.executor.progress import Silent

if TYPE_CHECKING:
    from rich.progress import TaskID

    from quadlog.pipelines.batch.progress import BatchCounts, BatchProgress

MAX_NAME, MAX_LINES = 28, 32
"""Characters shown of a recording's name, and lines of workers."""


class WorkerLines(Silent):
    """A bar of the whole batch and a bar per worker; failures and warnings are printed above.

    The report of the whole folder, which follows the batch, has no bar.
    """

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        self._bars = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=20),
            TextColumn("{task.fields[words]}", markup=False),
            console=Console(stderr=True),
        )
        self._lines: dict[str, TaskID] = {}
        self._at: dict[str, str] = {}
        self._changing = Lock()

    def __enter__(self) -> WorkerLines:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    def say(self, text: str) -> None:
        """A line above the bars."""
        self._bars.console.print(printable(text), markup=False, highlight=False, soft_wrap=True)

    def expect(self, tally: BatchCounts, workers: int) -> None:
        """Add the bar of the whole batch."""
        self._tally, self._workers = tally, workers
        self._total = self._bars.add_task("total", total=tally.recordings, words=total_words(tally, workers))

    def hear(self, step: Mapping[str, Any]) -> None:
        """Update the bar of a worker."""
        worker, run = step["worker"], printable(step["run"])[:MAX_NAME]
        described = f"{run:<{MAX_NAME}} {step['stage']:<9}"
        shown = {"total": step["total"] or None, "completed": step["steps"], "words": step_words(step)}
        with self._changing:
            if worker not in self._lines:
                if len(self._lines) == MAX_LINES:
                    return
                self._lines[worker] = self._bars.add_task(described, words="")
            self._at[worker] = step["run"]
            self._bars.update(self._lines[worker], description=described, **shown)

    def finish(self, run: str, words: str) -> None:
        """Remove the bar of the run's worker; print the outcome unless it is `done`."""
        if words != "done":
            self.say(f"{run}: {words}")
        with self._changing:
            for worker in [worker for worker, at in self._at.items() if at == run]:
                del self._at[worker]
                self._bars.remove_task(self._lines.pop(worker))
            words = total_words(self._tally, self._workers)
            self._bars.update(self._total, completed=self._tally.done, words=words)


def step_words(step: Mapping[str, Any]) -> str:
    """Steps of the stage, real-time factor, and name of the worker."""
    far = f"{step['steps']}/{step['total']}" if step["total"] else f"{step['steps']}" if step["steps"] else ""
    factor = step["realtime_factor"]
    rate = "" if factor is None else f"{factor:.1f}x real time"
    return "  ".join(word for word in (far, rate, str(step["worker"])) if word)


def total_words(tally: BatchCounts, workers: int) -> str:
    """Numbers of finished and failed recordings, and the time left once it is known."""
    words = f"{tally.done}/{tally.recordings} recordings"
    words += f", {tally.failed} failed" if tally.failed else ""
    left_s = tally.left_s(workers)
    return words if left_s is None or tally.done == tally.recordings else f"{words}, {duration_words(left_s)} left"


def duration_words(seconds: float) -> str:
    """Seconds, minutes, or hours and minutes."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{seconds / 60:.0f} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60:02d} min"


def open_batch_progress() -> AbstractContextManager[BatchProgress]:
    """A bar per worker where stderr is a terminal, a line per recording elsewhere."""
    from quadlog.pipelines.batch.progress import BatchLines

    if sys.stderr.isatty():
        return WorkerLines()
    return nullcontext(BatchLines(lambda text: click.echo(printable(text), err=True)))


class Lines(Silent):
    """Choices and warnings as plain lines, for a stderr that is not a terminal."""

    def say(self, text: str) -> None:
        """One line on stderr."""
        click.echo(printable(text), err=True)


class Bars:
    """A bar per stage."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

        self._bars = Progress(
            TextColumn("{task.description:<9}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[rate]}"),
            console=Console(stderr=True),
        )
        self._task: TaskID | None = None
        self._steps, self._started = 0, 0.0

    def __enter__(self) -> Bars:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if value is None:
            self._complete()
        self._bars.stop()

    def begin(self, stage: str, total: int | None) -> None:
        """A new bar below the others."""
        self._complete()
        self._task = self._bars.add_task(stage, total=total, rate="")
        self._steps, self._started = 0, time.perf_counter()

    def _complete(self) -> None:
        """Show the last stage as full, also one of unknown length."""
        if self._task is not None:
            steps = max(self._steps, 1)
            self._bars.update(self._task, total=steps, completed=steps)

    def advance(self, recorded_s: float | None = None) -> None:
        """One more step, with the mean rate."""
        if self._task is None:
            return
        self._steps += 1
        elapsed_s = max(time.perf_counter() - self._started, 1e-9)
        rate = f"{self._steps / elapsed_s:.0f}/s"
        if recorded_s is not None:
            rate += f", {recorded_s / elapsed_s:.1f}x real time"
        self._bars.update(self._task, advance=1, rate=rate)

    def say(self, text: str) -> None:
        """A line above the bars."""
        self._bars.console.print(printable(text), markup=False, highlight=False, soft_wrap=True)


def open_progress() -> AbstractContextManager[Bars] | AbstractContextManager[Lines]:
    """Bars where stderr is a terminal, lines elsewhere."""
    return Bars() if sys.stderr.isatty() else nullcontext(Lines())
