"""What commands show: lines on stderr, JSON on stdout, and progress: bars in a terminal, lines elsewhere."""

from __future__ import annotations

import json
import shutil
import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

import click

from quadlog.errors import printable
from quadlog.pipelines.batch.progress import BatchLines

if TYPE_CHECKING:
    from rich.progress import TaskID

    from quadlog.pipelines.batch.progress import BatchCounts

MAX_NAME, MAX_LINES = 20, 32
"""Characters shown of a recording's name, and lines of workers."""


def say(text: object) -> None:
    """One line on stderr, without control characters."""
    click.echo(printable(text), err=True)


def print_json(value: object) -> None:
    """A value on stdout, as JSON."""
    click.echo(json.dumps(value, indent=2, allow_nan=False))


def table_lines(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str], most: int = 40) -> Iterator[str]:
    """The first rows as a table that fits the terminal: values by key, below their titles; no column without values."""
    from quadlog.results.text import print_table, terminal_width

    if rows:
        names = [name for name in columns if any(row[name] is not None for row in rows)]
        cells = [[row[name] for name in names] for row in rows[:most]]
        yield from print_table([columns[name] for name in names], cells, width=terminal_width()).splitlines()
    yield from left_out(len(rows) - most)


def left_out(count: int) -> list[str]:
    """A line on what is not printed, if it is something."""
    return [f"  and {count} more, all of them in --json"] if count > 0 else []


def folded(line: str) -> str:
    """The line without control characters, in a terminal broken at spaces to its width."""
    if not sys.stdout.isatty():
        return printable(line)
    width = shutil.get_terminal_size().columns  # a topic's name may hold hyphens, and is not broken
    return textwrap.fill(
        printable(line), width, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False
    )


def report_skipped(runs: Sequence[Path]) -> None:
    """Name on stderr the plain files among the arguments that lie beside run folders, as `runs/*` gives them."""
    from quadlog.results.find_runs import files_beside_runs

    if skipped := files_beside_runs(runs):
        say(f"skipped, not a run folder: {', '.join(map(str, skipped))}")


def open_progress() -> AbstractContextManager[BatchLines]:
    """Bars where stderr is a terminal; elsewhere a line for each message and each recording of a batch."""
    return Bars() if sys.stderr.isatty() else nullcontext(BatchLines(say))


class Bars(BatchLines):
    """A bar for each stage of a recording; of a batch one for the whole and one for each worker. Lines go above."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        super().__init__(self._print)
        columns = TextColumn("{task.description}", markup=False), TextColumn("{task.fields[words]}", markup=False)
        self._bars = Progress(
            columns[0], BarColumn(bar_width=12), columns[1], console=Console(stderr=True), speed_estimate_period=3600
        )
        self._first: TaskID | None = None  # the current stage, or the whole batch
        self._recorded_s: float | None = None
        self._workers: dict[str, tuple[TaskID, str]] = {}
        self._changing = Lock()

    def __enter__(self) -> Bars:
        self._bars.start()
        return self

    def __exit__(self, kind: object, value: BaseException | None, trace: object) -> None:
        if value is None:
            self._describe(ended=True)
        self._bars.stop()

    def _print(self, text: str) -> None:
        self._bars.console.print(printable(text), markup=False, highlight=False, soft_wrap=True)

    def begin(self, stage: str, total: int | None) -> None:
        """A new bar below the others."""
        self._describe(ended=True)
        self._first, self._recorded_s = self._bars.add_task(f"{stage:<9}", total=total, words=""), None

    def advance(self, recorded_s: float | None = None) -> None:
        """One more step, with the mean rate and the time left."""
        if self._first is not None:
            self._bars.advance(self._first)
            self._recorded_s = recorded_s
            self._describe()

    def _describe(self, ended: bool = False) -> None:
        """Steps and rate of the current stage, and the time left; when it has ended, its duration and a full bar."""
        if self._first is None or self._tally.recordings:
            return
        task = self._bars.tasks[-1]
        spent_s, left_s = task.finished_time or task.elapsed or 0.0, task.time_remaining
        factor = None if self._recorded_s is None or not spent_s else self._recorded_s / spent_s
        step = {"steps": round(task.completed), "total": task.total, "realtime_factor": factor}
        last = duration_words(spent_s) if ended else f"{duration_words(left_s)} left" if left_s else ""
        full: dict[str, Any] = {"total": max(task.completed, 1), "completed": max(task.completed, 1)} if ended else {}
        self._bars.update(self._first, words=step_words(step, last), **full)

    def expect(self, tally: BatchCounts) -> None:
        """Add the bar of the whole batch."""
        super().expect(tally)
        self._first = self._bars.add_task("total", total=tally.recordings, words="")
        self._show_total()

    def _show_total(self) -> None:
        """Numbers of finished and failed recordings, and the time left once it is known."""
        assert self._first is not None, "a batch starts with expect"
        tally = self._tally
        self._bars.update(self._first, completed=tally.done)
        left_s = next(task for task in self._bars.tasks if task.id == self._first).time_remaining
        words = f"{tally.done}/{tally.recordings} recordings" + (f", {tally.failed} failed" if tally.failed else "")
        words += f", {duration_words(left_s)} left" if left_s is not None and tally.done < tally.recordings else ""
        self._bars.update(self._first, words=words)

    def hear(self, step: Mapping[str, Any]) -> None:
        """Update the bar of a worker."""
        worker, run = step["worker"], printable(step["run"])[:MAX_NAME]
        shown = {"total": step["total"] or None, "completed": step["steps"], "words": step_words(step, worker)}
        with self._changing:
            if worker not in self._workers and len(self._workers) == MAX_LINES:
                return
            task = self._workers[worker][0] if worker in self._workers else self._bars.add_task("", words="")
            self._workers[worker] = task, step["run"]
            self._bars.update(task, description=f"{run:<{MAX_NAME}} {step['stage']:<9}", **shown)

    def finish(self, run: str, words: str) -> None:
        """Remove the bar of the run's worker; print the outcome unless it is `done`."""
        if words != "done":
            self.say(f"{run}: {words}")
        with self._changing:
            for worker in [worker for worker, (_, at) in self._workers.items() if at == run]:
                self._bars.remove_task(self._workers.pop(worker)[0])
            self._show_total()


def step_words(step: Mapping[str, Any], last: str) -> str:
    """Steps of the stage, real-time factor, and the last words."""
    steps, total, factor = step["steps"], step["total"], step["realtime_factor"]
    far = f"{steps}/{total:g}" if total else f"{steps}" if steps else ""
    return "  ".join(filter(None, (far, "" if factor is None else f"{factor:.1f}x real time", last)))


def duration_words(seconds: float) -> str:
    """Seconds, minutes, or hours and minutes."""
    minutes = round(seconds / 60)
    longer = f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60:02d} min"
    return f"{seconds:.0f} s" if seconds < 60 else longer
