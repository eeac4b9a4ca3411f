"""Replay many recordings: a failure does not stop the rest, and summary.parquet has its reason."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

from quadlog.errors import CannotWrite, ExitCode, RunExists
from quadlog.pipelines.batch.plan import Planned, existing_runs
from quadlog.pipelines.batch.progress import BatchProgress
from quadlog.pipelines.batch.remote import replay_anywhere
from quadlog.pipelines.batch.run import BatchRun
from quadlog.pipelines.batch.summary import summarise
from quadlog.pipelines.batch.task import BatchTask, measured
from quadlog.pipelines.executor.executor import open_engine
from quadlog.pipelines.executor.progress import Progress
from quadlog.pipelines.request import Existing, ReplayOutcome, ReplayRequest
from quadlog.results.places import place_of_new
from quadlog.results.record import is_finished
from quadlog.storage.atomic_write import part_prefix, remove_stale_parts

SHOWN_FAILURES = 20


@dataclass(frozen=True, slots=True)
class BatchOutcome:
    """The outcome of every recording, in their order, and the exit code of the batch."""

    runs: tuple[ReplayOutcome, ...]

    @property
    def exit_code(self) -> int:
        """0: all done; 1: none done; 3: something lost or failed."""
        codes = {run.exit_code for run in self.runs}
        if codes == {ExitCode.FAILED}:
            return ExitCode.FAILED
        return ExitCode.DONE if codes <= {ExitCode.DONE} else ExitCode.WITH_LOSS

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


def replay_alone(planned: Planned, progress: Progress) -> BatchOutcome:
    """Replay a single recording in this process. Raises its error."""
    cost: dict[str, Any] = {}
    with measured(cost, planned.request.run, planned.size_bytes):
        outcome = replay_anywhere(planned.request, progress)
    outcome = replace(outcome, cost=cost)
    summarise({planned.request.run.parent}, [outcome], progress)
    return BatchOutcome((outcome,))


def replay_batch(batch: Sequence[Planned], jobs: int, scheduler: str | None, progress: BatchProgress) -> BatchOutcome:
    """Replay all, the largest first, in `jobs` worker processes or on a Dask cluster, and summarise them.

    An error is the outcome of its recording. Raises ClusterUnusable and VersionsDiffer before anything is replayed.
    After Ctrl-C, which stops all workers, `--resume` continues.
    """
    with open_workers(batch, jobs, scheduler, progress) as replay_all:
        outcomes = replay_all(batch)
    summarise({each.request.run.parent for each in batch}, outcomes, progress)
    return BatchOutcome(outcomes)


ReplayAll = Callable[[Sequence[Planned]], tuple[ReplayOutcome, ...]]
"""Replays recordings and returns their outcomes in the same order; none is started after the workers were halted."""


@contextmanager
def open_workers(
    batch: Sequence[Planned], jobs: int, scheduler: str | None, progress: BatchProgress, *, repeats: bool = True
) -> Iterator[ReplayAll]:
    """Workers for a batch, which may be replayed in several parts, one after the other. Raises as replay_batch.

    repeats: whether a warning is printed for each run that has it, or once.
    """
    folders = {each.request.run.parent for each in batch}
    runs, said = [BatchRun([], progress)], None if repeats else set[str]()
    with ExitStack() as stack:
        stack.callback(_clear_unfinished, batch)  # after the workers have stopped
        shared = stack.enter_context(_seen_by_all(folders if scheduler else set()))
        engine = stack.enter_context(open_engine(min(jobs, len(batch)), scheduler, lambda step: runs[-1].hear(step)))
        if engine.greeting:
            progress.say(engine.greeting)

        def replay_all(part: Sequence[Planned]) -> tuple[ReplayOutcome, ...]:
            refused = _refused(part)
            order = sorted(range(len(part)), key=lambda number: (-part[number].size_bytes, number))
            tasks = [_task(part, number, shared) for number in order if number not in refused]
            runs.append(BatchRun(tasks, progress, runs[-1].halted, said))
            runs[-1].go(engine)
            ended = refused | runs[-1].outcomes
            return tuple(
                replace(ended[number], recording=each.request.recording, run=each.request.run)
                for number, each in enumerate(part)
            )

        yield replay_all


def _clear_unfinished(batch: Sequence[Planned]) -> None:
    """Remove unfinished files of stopped workers on this machine, which may have missed a file when the signal came."""
    local = [each.request.run for each in batch if isinstance(each.request.run, Path)]
    for run in (place for each in local for place in (each, place_of_new(each))):
        if run.is_dir() and not is_finished(run):
            for folder in (run, run / "plots"):
                with suppress(OSError):
                    remove_stale_parts(folder)


def _task(batch: Sequence[Planned], number: int, shared: Mapping[Path, Path]) -> BatchTask:
    """As REFUSE was handled already, RESUME lets a second worker continue what a killed one began."""
    request, size_bytes = batch[number].request, batch[number].size_bytes
    passing, refuses = shared.get(request.run.parent), request.existing is Existing.REFUSE
    if refuses:
        request = replace(request, existing=Existing.RESUME)
    anywhere = _from_anywhere(request)  # fails for relative paths where the working folder was deleted
    return BatchTask(number, anywhere if shared else request, size_bytes, passing, refuses)


def _from_anywhere(request: ReplayRequest) -> ReplayRequest:
    """With absolute paths, for workers with another working folder."""
    options = replace(request.options, msg_path=tuple(map(_absolute, request.options.msg_path)))
    return replace(request, recording=_absolute(request.recording), run=_absolute(request.run), options=options)


def _absolute(path: Path) -> Path:
    return path.absolute() if isinstance(path, Path) else path  # a URL


def _refused(batch: Sequence[Planned]) -> dict[int, ReplayOutcome]:
    """Outcomes by number of the recordings whose runs exist and may be neither replaced nor resumed."""
    there = existing_runs(batch)
    refused = {}
    for number, each in enumerate(batch):
        if each.request.existing is Existing.REFUSE and each.request.run in there:
            error = RunExists(each.request.run)
            refused[number] = ReplayOutcome.of_failure(each.request, str(error), refused=True)
    return refused


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


@contextmanager
def _seen_by_all(folders: Collection[Path]) -> Iterator[dict[Path, Path]]:
    """A temporary file in each output folder, by which workers elsewhere check that they see the same folder."""
    with ExitStack() as stack:
        shared = {}
        for folder in folders:
            if not isinstance(folder, Path):
                continue  # a URL: the same for all
            try:
                if not folder.exists():
                    folder.mkdir(parents=True)
                    stack.callback(_remove_if_empty, folder)  # nothing was replayed: there was no worker
                passing = stack.enter_context(
                    NamedTemporaryFile(dir=folder, prefix=part_prefix(os.getpid()), suffix=".part")
                )
            except OSError as error:
                raise CannotWrite(folder, error.strerror or str(error)) from error
            shared[folder] = Path(passing.name).absolute()
        yield shared
