"""What commands show: lines on stderr, JSON on stdout, and progress: bars in a terminal, lines elsewhere."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from quadlog.errors import printable
from quadlog.pipelines.executor.progress import BatchLines, working_s

if TYPE_CHECKING:
    from rich.progress import TaskID

    from quadlog.pipelines.executor.progress import BatchCounts

MAX_NAME = 20
"""Characters shown of a recording's name."""


def say(text: object) -> None:
    """One line on stderr, without control characters; in a terminal broken at spaces."""
    click.echo(_folded(printable(text)) if sys.stderr.isatty() else printable(text), err=True)


def _folded(text: str) -> str:
    from quadlog.results.text import ASCII, terminal_width, wrapped

    return "\n".join(wrapped(text, terminal_width(), "  ")).translate(ASCII)


def print_json(value: object) -> None:
    """A value on stdout, as JSON."""
    click.echo(json.dumps(value, indent=2, allow_nan=False))


MOST_ROWS = 40


def table_lines(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> Iterator[str]:
    """The first rows as a table that fits the terminal."""
    for lines in laid_out(rows[:MOST_ROWS], columns):
        yield from lines
    yield from left_out(len(rows) - MOST_ROWS)


def laid_out(rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> list[list[str]]:
    """As table_rows: values by key, below their titles; no column without values, and nothing without rows."""
    from quadlog.results.text import table_rows, terminal_width

    names = [name for name in columns if any(row[name] is not None for row in rows)]
    cells = [[row[name] for name in names] for row in rows]
    return table_rows([columns[name] for name in names], cells, terminal_width()) if rows else []


def left_out(count: int) -> list[str]:
    """A line on what is not printed, if it is something."""
    return [f"  and {count} more, all of them in --json"] if count > 0 else []


def show(text: str, to: str = "table") -> None:
    """Lines on stdout without control characters, in a terminal broken at spaces to its width; a format as it is."""
    from quadlog.results.text import ASCII, terminal_width, wrapped

    if to != "table":
        click.echo(text, nl=False)
        return
    lines = map(printable, text.removesuffix("\n").split("\n"))
    width = terminal_width() if sys.stdout.isatty() else math.inf
    click.echo("\n".join(part for line in lines for part in wrapped(line, width, "    ")).translate(ASCII))


def report_skipped(runs: Sequence[Path]) -> None:
    """Name on stderr the plain files among the arguments that lie beside run folders, as `runs/*` gives them."""
    from quadlog.results.find_runs import files_beside_runs

    if skipped := files_beside_runs(runs):
        say(f"skipped, not a run folder: {', '.join(map(str, skipped))}")


def open_progress(notes: bool = True) -> BatchLines:
    """Bars where stderr is a terminal; elsewhere a line for each message and each recording of a batch."""
    return Bars(notes) if sys.stderr.isatty() else BatchLines(say, notes)


class Bars(BatchLines):
    """A bar for each stage of a recording, or one for a batch and what it has done last. Lines go above."""

    def __init__(self, notes: bool = True) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        super().__init__(self._print, notes)
        self._bars = Progress(
            *(TextColumn("{task.description}", markup=False), BarColumn(bar_width=12), MofNCompleteColumn()),
            *(TimeRemainingColumn(elapsed_when_finished=True), TextColumn("{task.fields[words]}", markup=False)),
            console=Console(stderr=True),
            speed_estimate_period=3600,
        )
        self._first: TaskID | None = None  # the current stage, or the whole batch
        self._kernels: TaskID | None = None
        self._began_s = 0.0

    def __enter__(self) -> Bars:
        self._bars.start()
        return self

    def __exit__(self, kind: object, value: BaseException | None, trace: object) -> None:
        if value is None:
            self._end()
        self._bars.stop()

    def _print(self, text: str) -> None:
        self._bars.console.print(_folded(printable(text)), markup=False, highlight=False, soft_wrap=True)

    def begin(self, stage: str, total: int | None) -> None:
        """A new bar below the others."""
        self._end()
        self._first, self._began_s = self._bars.add_task(f"{stage:<9}", total=total, words=""), working_s()

    def _end(self) -> None:
        """A full bar, with its duration, for the stage that has ended."""
        if self._first is not None and not self._tally.recordings:
            steps = max(self._bars.tasks[self._first].completed, 1)
            self._bars.update(self._first, total=steps, completed=steps)

    def advance(self, recorded_s: float | None = None) -> None:
        """One more step, and the mean rate."""
        if self._first is not None:
            rate = _rate(recorded_s and recorded_s / max(working_s() - self._began_s, 1e-9))
            self._bars.update(self._first, advance=1, words=rate)

    def compiled(self, kernels: int) -> None:
        """A bar of its own."""
        if self._kernels is None:
            self._kernels = self._bars.add_task("compile  ", total=None, words="")
        self._bars.update(self._kernels, completed=kernels, words="kernels")

    def expect(self, tally: BatchCounts) -> None:
        """Add the bar of the whole batch."""
        super().expect(tally)
        self._first = self._bars.add_task("recordings", total=tally.recordings, words="")

    def hear(self, step: Mapping[str, Any]) -> None:
        """Show what a worker has done last."""
        run, rate = printable(step["run"])[:MAX_NAME], _rate(step["realtime_factor"])
        self._show(f"{run} {step['stage']} {step['steps']}/{step['total'] or '?'} {rate}")

    def finish(self, run: str, words: str) -> None:
        """Print the outcome unless it is `done`."""
        if words != "done":
            self.say(f"{run}: {words}")
        self._show(printable(run)[:MAX_NAME])

    def _show(self, words: str) -> None:
        failed = f"{self._tally.failed} failed, " if self._tally.failed else ""
        assert self._first is not None, "a batch starts with expect"
        self._bars.update(self._first, completed=self._tally.done, words=f"{failed}{words}")


def _rate(factor: float | None) -> str:
    return f"{factor:.1f}x real time" if factor else ""
