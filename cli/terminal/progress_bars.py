"""Progress on stderr, of one replay and of a batch: bars in a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from threading import Lock
from types import TracebackType
from typing import TYPE_CHECKING, Any

import click

from quadlog.errors import printable
from quadlog.pipelines.batch.progress import BatchLines

if TYPE_CHECKING:
    from rich.progress import TaskID

    from quadlog.pipelines.batch.progress import BatchCounts

MAX_NAME, MAX_LINES = 20, 32
"""Characters shown of a recording's name, and lines of workers."""


def open_progress() -> AbstractContextManager[BatchLines]:
    """Bars where stderr is a terminal; elsewhere a line for each message and each recording of a batch."""
    if sys.stderr.isatty():
        return Bars()
    return nullcontext(BatchLines(lambda text: click.echo(printable(text), err=True)))


class Bars(BatchLines):
    """A bar for each stage of a recording; of a batch one for the whole and one for each worker. Lines go above."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        super().__init__(self._print)
        self._bars = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=12),
            TextColumn("{task.fields[words]}", markup=False),
            console=Console(stderr=True),
            speed_estimate_period=3600.0,  # recordings may take minutes
        )
        self._first: TaskID | None = None  # the current stage, or the whole batch
        self._recorded_s: float | None = None
        self._workers: dict[str, TaskID] = {}
        self._runs: dict[str, str] = {}
        self._changing = Lock()

    def __enter__(self) -> Bars:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if value is None:
            self._complete()
        self._bars.stop()

    def _print(self, text: str) -> None:
        self._bars.console.print(printable(text), markup=False, highlight=False, soft_wrap=True)

    def begin(self, stage: str, total: int | None) -> None:
        """A new bar below the others."""
        self._complete()
        self._first = self._bars.add_task(f"{stage:<9}", total=total, words="")
        self._recorded_s = None

    def advance(self, recorded_s: float | None = None) -> None:
        """One more step, with the mean rate and the time left."""
        if self._first is None:
            return
        self._bars.advance(self._first)
        self._recorded_s, left_s = recorded_s, self._bars.tasks[-1].time_remaining
        self._describe(f"{duration_words(left_s)} left" if left_s else "")

    def _complete(self) -> None:
        """Show the last stage as full, also one of unknown length, with its duration."""
        if self._first is not None and not self._tally.recordings:
            task = self._bars.tasks[-1]
            self._describe(duration_words(task.finished_time or task.elapsed or 0.0))
            self._bars.update(self._first, total=max(task.completed, 1), completed=max(task.completed, 1))

    def _describe(self, last: str) -> None:
        """Show steps, rate and the last words of the current stage."""
        assert self._first is not None
        task = self._bars.tasks[-1]
        spent_s = task.finished_time or task.elapsed
        factor = None if self._recorded_s is None or not spent_s else self._recorded_s / spent_s
        step = {"steps": round(task.completed), "total": task.total, "realtime_factor": factor}
        self._bars.update(self._first, words=step_words(step, last))

    def expect(self, tally: BatchCounts) -> None:
        """Add the bar of the whole batch."""
        super().expect(tally)
        self._first = self._bars.add_task("total", total=tally.recordings, words=total_words(tally, None))

    def hear(self, step: Mapping[str, Any]) -> None:
        """Update the bar of a worker."""
        worker, run = step["worker"], printable(step["run"])[:MAX_NAME]
        shown = {"total": step["total"] or None, "completed": step["steps"], "words": step_words(step, worker)}
        with self._changing:
            if worker not in self._workers:
                if len(self._workers) == MAX_LINES:
                    return
                self._workers[worker] = self._bars.add_task("", words="")
            self._runs[worker] = step["run"]
            self._bars.update(self._workers[worker], description=f"{run:<{MAX_NAME}} {step['stage']:<9}", **shown)

    def finish(self, run: str, words: str) -> None:
        """Remove the bar of the run's worker; print the outcome unless it is `done`."""
        if words != "done":
            self.say(f"{run}: {words}")
        with self._changing:
            for worker in [worker for worker, at in self._runs.items() if at == run]:
                del self._runs[worker]
                self._bars.remove_task(self._workers.pop(worker))
            assert self._first is not None, "a batch starts with expect"
            self._bars.update(self._first, completed=self._tally.done)
            left_s = next(task for task in self._bars.tasks if task.id == self._first).time_remaining
            self._bars.update(self._first, words=total_words(self._tally, left_s))


def step_words(step: Mapping[str, Any], last: str) -> str:
    """Steps of the stage, real-time factor, and the last words."""
    steps, total, factor = step["steps"], step["total"], step["realtime_factor"]
    far = f"{steps}/{total:g}" if total else f"{steps}" if steps else ""
    rate = "" if factor is None else f"{factor:.1f}x real time"
    return "  ".join(word for word in (far, rate, last) if word)


def total_words(tally: BatchCounts, left_s: float | None) -> str:
    """Numbers of finished and failed recordings, and the time left once it is known."""
    words = f"{tally.done}/{tally.recordings} recordings"
    words += f", {tally.failed} failed" if tally.failed else ""
    return words if left_s is None or tally.done == tally.recordings else f"{words}, {duration_words(left_s)} left"


def duration_words(seconds: float) -> str:
    """Seconds, minutes, or hours and minutes."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{seconds / 60:.0f} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60:02d} min"
