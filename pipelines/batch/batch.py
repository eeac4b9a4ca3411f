"""Replay many recordings: a failure does not stop the rest, and summary.parquet has its reason."""

from __future__ import annotations

import gc
import sys
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty
from typing import Any

from quadlog import errors
from quadlog.pipelines.batch.plan import existing_runs
from quadlog.pipelines.batch.summary import note_failure, summarise
from quadlog.pipelines.executor.machine import is_out_of_memory
from quadlog.pipelines.executor.pool import Workers, open_executor
from quadlog.pipelines.executor.progress import (
    BatchCounts,
    BatchLines,
    Progress,
    TaskProgress,
    forget_peak_memory,
    peak_memory_mb,
    worker_name,
)
from quadlog.pipelines.replay import finished_outcome, replay
from quadlog.pipelines.request import GOES_ON, Existing, ReplayOutcome, ReplayRequest
from quadlog.pipelines.store import Store
from quadlog.results import reused_words
from quadlog.results.record import is_finished
from quadlog.results.run import STORE
from quadlog.storage.atomic_write import is_full, remove_stale_parts

SHOWN_FAILURES = 20
LOOK_AGAIN_S = 5.0
"""How often a cluster is asked for its size while nothing happens."""
WORTH_COLLECTING_S = 5.0
"""Figures leave reference cycles of some 20 MB. Collecting them takes 0.1 s, too long after every short recording."""


@dataclass(frozen=True, slots=True)
class BatchOutcome:
    """The outcome of every recording, in their order, and the exit code of the batch."""

    runs: tuple[ReplayOutcome, ...]

    @property
    def exit_code(self) -> int:
        """0: all done; 1: none done; 3: something lost or failed."""
        codes = {run.exit_code for run in self.runs}
        if codes == {errors.ExitCode.FAILED}:
            return errors.ExitCode.FAILED
        return errors.ExitCode.DONE if codes <= {errors.ExitCode.DONE} else errors.ExitCode.WITH_LOSS

    def failure_lines(self, many: str = "recordings", table: str = "summary.parquet") -> list[str]:
        """Number of failures and the reasons of the first ones; of a single recording its reason."""
        failed = [run for run in self.runs if run.failed]
        if not failed:
            return []
        if len(self.runs) == 1:
            return [f"quadlog: {failed[0].recording}: {failed[0].reason}"]
        lines = [f"{len(failed)} of {len(self.runs)} {many} failed:"]
        lines += [f"  {run.recording}: {run.reason}" for run in failed[:SHOWN_FAILURES]]
        left = len(failed) - SHOWN_FAILURES
        return lines if left <= 0 else [*lines, f"  and {left} more, which {table} lists with their reasons"]


def replay_alone(request: ReplayRequest, progress: Progress) -> BatchOutcome:
    """Replay a single recording in this process. Raises its error."""
    outcome = replay(request, progress)
    summarise(request.run.parent, progress)
    trim_stores([request])
    return BatchOutcome((outcome,))


def replay_batch(
    batch: Sequence[ReplayRequest], jobs: int, scheduler: str | None, progress: BatchLines
) -> BatchOutcome:
    """Replay all, the largest first, in `jobs` worker processes or on a Dask cluster, and summarise them.

    An error is the outcome of its recording. Raises QuadlogError and VersionsDiffer before anything is replayed.
    After Ctrl-C, which stops all workers, `--resume` continues.
    """
    outcomes = replay_all(batch, jobs, scheduler, progress)
    for outcome in outcomes:
        if outcome.failed and not outcome.refused:
            note_failure(outcome)
    for folder in sorted({each.run.parent for each in batch}):
        try:
            summarise(folder, progress)
        except errors.QuadlogError as error:  # a full disk, or a run that is damaged
            progress.say(f"warning: no summary: {error}")
    trim_stores(batch)
    return BatchOutcome(outcomes)


def trim_stores(batch: Sequence[ReplayRequest]) -> None:
    """Remove results that no run has, but for those of replays that did not finish, with which `--resume` goes on."""
    for folder in {each.run.parent for each in batch}:
        if isinstance(folder, Path):
            Store(folder).trim()


def replay_all(
    batch: Sequence[ReplayRequest], jobs: int, scheduler: str | None, progress: BatchLines
) -> tuple[ReplayOutcome, ...]:
    """The outcome of each recording, in their order; a warning that several have is printed once. As replay_batch."""
    try:
        with open_executor(min(jobs, len(batch)), scheduler) as workers:
            if workers.greeting:
                progress.say(workers.greeting)
            return _Batch(batch, workers, progress).replay()
    finally:  # the workers have ended, and may have been killed
        for run in (each.run for each in batch if isinstance(each.run, Path)):
            with suppress(OSError):
                remove_stale_parts(run.parent / STORE)


def replay_task(request: ReplayRequest, number: int, refuses: bool) -> tuple[ReplayOutcome, list[str], bool]:
    """In a worker: the outcome of one recording, errors among them; its warnings; and whether the disk is full.

    refuses: a run that another process finished meanwhile is refused; what a killed worker began of it is continued.
    """
    progress, began_s, full = TaskProgress(number, request.run.name), time.monotonic(), False
    forget_peak_memory()
    progress.begin("open", None)
    try:
        if refuses and is_finished(request.run) and finished_outcome(request) is None:
            raise errors.RunExists(request.run)
        outcome = replay(request, progress)
    except (errors.AlreadyExists, errors.RunOfAnother) as error:
        outcome = ReplayOutcome.of_failure(request, str(error), refused=True)
    except Exception as error:
        cause: BaseException | None = error
        while cause is not None and not full:
            full, cause = isinstance(cause, OSError) and is_full(cause), cause.__cause__
        outcome = ReplayOutcome.of_failure(request, _failure_words(error, request.run, peak_memory_mb()))
    if request.draws and time.monotonic() - began_s > WORTH_COLLECTING_S:
        gc.collect()
    return outcome, progress.warnings, full


def _failure_words(error: Exception, run: Path, peak_mb: float | None) -> str:
    """The error in one line; for a bug its traceback is printed, too."""
    words = " ".join(str(error).split())
    if is_out_of_memory(error):
        return f"out of memory{_peak_words(peak_mb)}; {GOES_ON}"
    if isinstance(error, errors.RecordingNotFound):
        return f"{words} (on {worker_name()})"
    if isinstance(error, OSError):
        return f"{error.filename or run}: {error.strerror or words}"
    if isinstance(error, errors.QuadlogError):
        return words
    traceback.print_exception(error, file=sys.stderr)
    return f"a bug in quadlog: {type(error).__name__}: {words}"


def _peak_words(peak_mb: float | None) -> str:
    return "" if peak_mb is None else f", {peak_mb:.0f} MB at its peak"


class _Batch:
    """The state of a batch while it runs. halted: why no more recordings are started; empty while they are."""

    def __init__(self, batch: Sequence[ReplayRequest], workers: Workers, progress: BatchLines) -> None:
        self._batch, self._workers, self._progress = batch, workers, progress
        self._outcomes: dict[int, ReplayOutcome] = {}
        self._running: dict[Future[Any], int] = {}
        self._tries: Counter[int] = Counter()
        self._peak_mb: dict[int, float] = {}
        self._said: set[str] = set()
        self._halted = ""

    def replay(self) -> tuple[ReplayOutcome, ...]:
        """The outcomes, in the order of the recordings. Ctrl-C is reported with the number done, and raised again."""
        there = existing_runs(self._batch)
        for number, each in enumerate(self._batch):
            if each.existing is Existing.REFUSE and each.run in there:
                why = str(errors.RunExists(each.run))
                self._outcomes[number] = ReplayOutcome.of_failure(each, why, refused=True)
        todo = [number for number in range(len(self._batch)) if number not in self._outcomes]
        self._tally = BatchCounts(len(todo))
        self._progress.expect(self._tally)
        for number in sorted(todo, key=lambda number: (-self._batch[number].size_bytes, number)):
            self._submit(number)
        try:
            self._go()
        except KeyboardInterrupt:
            self._progress.say(f"interrupted with {self._tally.done} of {self._tally.recordings} recordings done")
            raise
        return tuple(self._outcomes[number] for number in range(len(self._batch)))

    def _submit(self, number: int) -> None:
        """Submit a task, or end it when halted. RESUME for REFUSE: a second try goes on where a killed one was."""
        if self._halted:
            self._end(number, "")
            return
        request = self._batch[number]
        refuses = request.existing is Existing.REFUSE
        request = replace(request, existing=Existing.RESUME) if refuses else request
        if self._workers.address:  # of workers with another working folder
            options = replace(request.options, msg_path=tuple(map(_absolute, request.options.msg_path)))
            request = replace(request, recording=_absolute(request.recording), run=_absolute(request.run))
            request = replace(request, options=options)
        future = self._workers.submit(replay_task, request, number, refuses)
        self._tries[number] += 1
        self._running[future] = number
        future.add_done_callback(self._workers.messages.put)

    def _go(self) -> None:
        """Handle messages until every task has an outcome; wait, with a line, while a cluster has no workers."""
        idle, waiting = True, False
        while self._running:
            if idle and waiting != (self._workers.count() == 0):
                waiting = not waiting
                words = f"no workers: waiting until one connects to {self._workers.address}; Ctrl-C stops, {GOES_ON}"
                self._progress.say(words if waiting else "a worker has connected: going on")
            try:
                came = self._workers.messages.get(timeout=LOOK_AGAIN_S)
            except Empty:
                idle = True
                continue
            idle = waiting
            if isinstance(came, Future):
                self._take(self._running.pop(came), came)
            elif came["number"] not in self._outcomes:
                self._peak_mb[came["number"]] = came["peak_memory_mb"]
                self._progress.hear(came)

    def _take(self, number: int, future: Future[Any]) -> None:
        """Take the outcome of a task that has ended, or submit the task again."""
        try:
            outcome, warnings, full = future.result()
        except self._workers.death:
            if self._tries[number] < self._workers.tries:
                self._submit(number)
                return
            if number not in self._peak_mb:
                self._halt("workers end before they begin: quadlog cannot be loaded there")
            again = ", and so was the next one" if self._workers.tries > 1 else ""
            words = f"its worker was killed{again}{_peak_words(self._peak_mb.get(number))}"
            self._end(number, f"{words}; out of memory is the usual cause; {GOES_ON}")
        except (CancelledError, errors.VersionsDiffer, ImportError) as error:
            self._halt(str(error) or "the scheduler has ended, or dropped what it was given")
            self._end(number, "")
        except Exception as error:
            self._end(number, _failure_words(error, self._batch[number].run, self._peak_mb.get(number)))
        else:
            if full:
                self._halt(f"disk full ({outcome.reason.removesuffix(f'; {GOES_ON}')})")
            self._end(number, outcome, warnings)

    def _end(self, number: int, ended: ReplayOutcome | str, warnings: Sequence[str] = ()) -> None:
        """ended: the outcome, or why there is none."""
        request = self._batch[number]
        if isinstance(ended, str):
            begun = "stopped" if number in self._peak_mb else "not started"
            words = f"{begun}: {self._halted}; {GOES_ON}" if self._halted else ended
            ended = ReplayOutcome.of_failure(request, words)
        outcome = replace(ended, recording=request.recording, run=request.run)  # as they were given
        if self._workers.address and not outcome.failed and not request.run.is_dir():
            words = f"{worker_name()} does not see the run that its worker made: share {request.run.parent}"
            outcome = ReplayOutcome.of_failure(request, words)
        self._outcomes[number] = outcome
        self._tally.done += 1
        self._tally.failed += outcome.failed
        for warning in warnings:
            if warning not in self._said:
                self._progress.say(f"{outcome.run.name}: {warning}")
        self._said.update(warnings)
        if self._halted and number not in self._peak_mb:
            return  # not begun: it stands among the failures, and is not worth a line of its own
        words = f"; {reused_words(outcome.reused, request.options.until)}" if outcome.reused else ""
        self._progress.finish(outcome.run.name, (outcome.reason or "done") + words)

    def _halt(self, reason: str) -> None:
        """Stop the batch, with one line for the user."""
        if not self._halted:
            self._halted = reason
            self._progress.say(f"stopping: {reason}; {GOES_ON}")
            self._workers.stop()


def _absolute(path: Path) -> Path:
    return path.absolute() if isinstance(path, Path) else path  # a URL
