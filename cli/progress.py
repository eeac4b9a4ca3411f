"""Progress on stderr: a bar per stage with steps per second and the real-time factor; plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from contextlib import AbstractContextManager, nullcontext
from types import TracebackType
from typing import TYPE_CHECKING

import click

from quadlog.text import printable

if TYPE_CHECKING:
    from rich.progress import TaskID


class Spoken:
    """Choices and warnings as plain lines, no bar: stderr is not a terminal."""

    def begin(self, stage: str, total: int | None) -> None:
        """A pipe needs no bar."""

    def advance(self, recorded_s: float | None = None) -> None:
        """A pipe needs no bar."""

    def say(self, text: str) -> None:
        """One line on stderr."""
        click.echo(printable(text), err=True)


class Bars:
    """One bar per stage."""

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
        """A stage whose number of steps nobody knew is full once it is over."""
        if self._task is not None:
            steps = max(self._steps, 1)
            self._bars.update(self._task, total=steps, completed=steps)

    def advance(self, recorded_s: float | None = None) -> None:
        """One step further, with the rate so far."""
        if self._task is None:
            return
        self._steps += 1
        elapsed_s = max(time.perf_counter() - self._started, 1e-9)
        rate = f"{self._steps / elapsed_s:.0f}/s"
        if recorded_s is not None:
            rate += f", {recorded_s / elapsed_s:.1f}x real time"
        self._bars.update(self._task, advance=1, rate=rate)

    def say(self, text: str) -> None:
        """One line above the bars."""
        self._bars.console.print(printable(text), markup=False, highlight=False, soft_wrap=True)


def open_progress() -> AbstractContextManager[Bars] | AbstractContextManager[Spoken]:
    """Bars where stderr is a terminal, lines elsewhere."""
    return Bars() if sys.stderr.isatty() else nullcontext(Spoken())
