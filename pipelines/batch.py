"""Many recordings, one replay each: a failure never stops the rest, and stands in summary.parquet with its reason."""

from __future__ import annotations

import multiprocessing
import os
import sys
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from quadlog.config import Config
from quadlog.errors import AlreadyExists, ExitCode, NotARun, QuadlogError
from quadlog.pipelines.progress import Kept, Progress
from quadlog.pipelines.replay import Existing, ReplayOptions, ReplayOutcome, ReplayRequest, finished_outcome, replay
from quadlog.recordings.find import find_recordings
from quadlog.results.names import run_names
from quadlog.results.record import own_files
from quadlog.results.schemas import METRIC_NAMES, TABLES
from quadlog.results.tables import has_table, read_table, write_table

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True, slots=True)
class Planned:
    """A recording, what would be done with it, and its size."""

    request: ReplayRequest
    action: str
    size_bytes: int

    def to_dict(self) -> dict[str, Any]:
        """One row of `--dry-run --json`."""
        recording, run = str(self.request.recording), str(self.request.run)
        return {"action": self.action, "recording": recording, "run": run, "size_bytes": self.size_bytes}


@dataclass(frozen=True, slots=True)
class BatchOutcome:
    """Every run in the order of the recordings, and the exit code of the whole."""

    runs: tuple[ReplayOutcome, ...]

    @property
    def exit_code(self) -> int:
        """0 all done, 1 none done, 3 anything lost or failed on the way."""
        codes = {run.exit_code for run in self.runs}
        if codes == {ExitCode.FAILED}:
            return ExitCode.FAILED
        return ExitCode.DONE if codes <= {ExitCode.DONE} else ExitCode.WITH_LOSS


def plan_batch(
    arguments: Sequence[str],
    output: Path,
    config: Config,
    options: ReplayOptions,
    existing: Existing,
    command: tuple[str, ...],
) -> list[Planned]:
    """What would run, and where to; nothing is written. Raises RecordingNotFound for an argument without recordings."""
    recordings = find_recordings(arguments)
    requests = [
        ReplayRequest(recording, output / name, config, options, existing, command)
        for recording, name in zip(recordings, run_names(recordings), strict=True)
    ]
    return [Planned(request, _action(request), _size(request.recording)) for request in requests]


def replay_batch(batch: Sequence[Planned], jobs: int | None, progress: Progress) -> BatchOutcome:
    """Replay all; in this process when there is one recording or one job, else in as many processes as jobs.

    A single recording's error is raised; of several, each has its own outcome.
    """
    requests = [each.request for each in batch]
    if len(requests) == 1:
        outcomes = [replay(requests[0], progress)]
    else:
        workers = min(jobs or os.cpu_count() or 1, len(requests))
        outcomes = list(_one_by_one(requests, progress) if workers == 1 else _in_processes(requests, workers, progress))
    summarise({request.run.parent for request in requests}, outcomes, progress)
    return BatchOutcome(tuple(outcomes))


def _one_by_one(requests: Sequence[ReplayRequest], progress: Progress) -> Iterator[ReplayOutcome]:
    for request in requests:
        yield _tell(progress, *_survive(request))


def _in_processes(requests: Sequence[ReplayRequest], workers: int, progress: Progress) -> list[ReplayOutcome]:
    """The largest recordings first. A worker that is killed takes the pool with it; the others then go on one by one.

    So only a recording that kills a worker of its own is blamed for it.
    """
    order = sorted(range(len(requests)), key=lambda index: (-_size(requests[index].recording), index))
    outcomes = _run_pool(requests, order, workers, progress)
    for index in order:
        if index not in outcomes:
            outcomes |= _run_pool(requests, [index], 1, progress)
        if index not in outcomes:
            reason = "its worker process was killed (out of memory?); --resume goes on"
            outcomes[index] = _tell(progress, ReplayOutcome.of_failure(requests[index], reason), ())
    return [outcomes[index] for index in range(len(requests))]


def _run_pool(
    requests: Sequence[ReplayRequest], order: Sequence[int], workers: int, progress: Progress
) -> dict[int, ReplayOutcome]:
    """Outcomes by index, of those that finished before a worker was killed, if one was."""
    outcomes: dict[int, ReplayOutcome] = {}
    # Fresh processes, because forked ones would inherit locks of libraries' threads.
    context = multiprocessing.get_context("spawn")
    with _one_thread_each(), ProcessPoolExecutor(workers, mp_context=context) as pool:
        try:
            futures = {pool.submit(_survive, requests[index]): index for index in order}
            for future in as_completed(futures):
                outcomes[futures[future]] = _tell(progress, *future.result())
        except BrokenProcessPool:
            pass
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in multiprocessing.active_children():
                worker.terminate()
            raise
    return outcomes


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Workers share the cores by recordings, not by threads: set here, because libraries read it when they load."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _survive(request: ReplayRequest) -> tuple[ReplayOutcome, tuple[str, ...]]:
    """The outcome of one recording of a batch, whatever happens to it, and what it had to say."""
    kept = Kept()
    try:
        outcome = replay(request, kept)
    except AlreadyExists as error:
        outcome = ReplayOutcome.of_failure(request, str(error), refused=True)
    except QuadlogError as error:
        outcome = ReplayOutcome.of_failure(request, " ".join(str(error).split()))
    except Exception as error:
        traceback.print_exc(file=sys.stderr)
        outcome = ReplayOutcome.of_failure(request, f"a bug in quadlog: {type(error).__name__}: {error}")
    return outcome, tuple(kept.lines)


def _tell(progress: Progress, outcome: ReplayOutcome, lines: Sequence[str]) -> ReplayOutcome:
    for line in lines:
        progress.say(f"{outcome.recording}: {line}")
    progress.say(f"{outcome.recording}: {outcome.reason or 'done'}")
    return outcome


def summarise(folders: set[Path], outcomes: Sequence[ReplayOutcome], progress: Progress) -> None:
    """summary.parquet and report.html of each output folder; rows of earlier commands stay, and others' files too."""
    from quadlog.results.folder_report import write_folder_report

    for folder in sorted(folders):
        if not folder.is_dir():
            continue
        rows = _earlier_rows(folder)
        if rows is None:
            progress.say(f"warning: {folder}: its summary.parquet or report.html is not quadlog's and is left alone")
            continue
        for outcome in outcomes:
            if not outcome.refused:
                rows[outcome.run.name] = _row(outcome)
        columns = {name: [rows[run][name] for run in sorted(rows)] for name in TABLES["summary"].names}
        write_table(folder / "summary.parquet", TABLES["summary"], columns)
        write_folder_report(folder)


def _row(outcome: ReplayOutcome) -> dict[str, Any]:
    values = {name: metric["value"] for name, metric in outcome.metrics.items()}
    own = {"recording": outcome.run.name, "exit_code": int(outcome.exit_code), "reason": outcome.reason}
    return own | {name: values.get(name, float("nan")) for name in METRIC_NAMES}


def _earlier_rows(folder: Path) -> dict[str, dict[str, Any]] | None:
    """Rows of runs that are still there; None when the folder's files of those names are somebody else's."""
    if not has_table(folder, "summary"):
        return None if (folder / "report.html").exists() else {}
    try:
        table = read_table(folder, "summary")
    except NotARun:
        return None
    count = len(table["recording"])
    rows = ({name: column[index] for name, column in table.items()} for index in range(count))
    return {row["recording"]: row for row in rows if (folder / row["recording"]).is_dir()}


def _action(request: ReplayRequest) -> str:
    if not request.run.exists():
        return "run"
    if request.existing is Existing.RESUME:
        return "skip" if finished_outcome(request) is not None else "resume"
    return "replace" if request.existing is Existing.FORCE else "refuse"


def _size(recording: Path) -> int:
    return sum(each.stat().st_size for each in own_files(recording))
