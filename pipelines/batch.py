"""Many recordings, one replay each: a failure never stops the rest, and stands in summary.parquet with its reason."""

from __future__ import annotations

import multiprocessing
import os
import sys
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from quadlog.config import Config
from quadlog.errors import NotARun, QuadlogError
from quadlog.pipelines.progress import Progress, Silent
from quadlog.pipelines.replay import Existing, ReplayOptions, ReplayOutcome, ReplayRequest, finished_outcome, replay
from quadlog.recordings.find import find_recordings
from quadlog.results.names import run_names
from quadlog.results.report import write_folder_report
from quadlog.results.schemas import METRIC_NAMES, TABLES
from quadlog.results.tables import read_table, write_table

DONE, FAILED, WITH_LOSS = 0, 1, 3


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
        if codes == {FAILED}:
            return FAILED
        return DONE if codes <= {DONE} else WITH_LOSS


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
    _summarise({request.run.parent for request in requests}, outcomes)
    return BatchOutcome(tuple(outcomes))


def _one_by_one(requests: Sequence[ReplayRequest], progress: Progress) -> Iterator[ReplayOutcome]:
    for request in requests:
        outcome = _survive(request)
        progress.say(_line(outcome))
        yield outcome


def _in_processes(requests: Sequence[ReplayRequest], workers: int, progress: Progress) -> list[ReplayOutcome]:
    """Fresh processes, because forked ones would inherit locks of libraries' threads; the largest recordings first."""
    context = multiprocessing.get_context("spawn")
    order = sorted(range(len(requests)), key=lambda index: (-_size(requests[index].recording), index))
    outcomes: dict[int, ReplayOutcome] = {}
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_one_thread_each) as pool:
        try:
            futures = {pool.submit(_survive, requests[index]): index for index in order}
            for future in as_completed(futures):
                index = futures[future]
                try:
                    outcomes[index] = future.result()
                except BrokenProcessPool:
                    reason = "its worker process was killed (out of memory?); --resume goes on"
                    outcomes[index] = ReplayOutcome.of_failure(requests[index], reason)
                progress.say(_line(outcomes[index]))
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [outcomes[index] for index in range(len(requests))]


def _one_thread_each() -> None:
    """Workers share the cores by recordings, not by threads: set before the libraries that read it are loaded."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"


def _survive(request: ReplayRequest) -> ReplayOutcome:
    """The outcome of one recording of a batch, whatever happens to it."""
    try:
        return replay(request, Silent())
    except QuadlogError as error:
        return ReplayOutcome.of_failure(request, " ".join(str(error).split()))
    except Exception as error:
        traceback.print_exc(file=sys.stderr)
        return ReplayOutcome.of_failure(request, f"a bug in quadlog: {type(error).__name__}: {error}")


def _summarise(folders: set[Path], outcomes: Sequence[ReplayOutcome]) -> None:
    """summary.parquet and report.html of each output folder; rows of earlier commands stay."""
    for folder in sorted(folders):
        if not folder.is_dir():
            continue
        rows = _earlier_rows(folder)
        for outcome in outcomes:
            values = {name: metric["value"] for name, metric in outcome.metrics.items()}
            own = {"recording": outcome.run.name, "exit_code": outcome.exit_code, "reason": outcome.reason}
            rows[outcome.run.name] = own | {name: values.get(name, float("nan")) for name in METRIC_NAMES}
        names = TABLES["summary"].names
        columns = {name: [rows[run][name] for run in sorted(rows)] for name in names}
        write_table(folder / "summary.parquet", TABLES["summary"], columns)
        write_folder_report(folder)


def _earlier_rows(folder: Path) -> dict[str, dict[str, Any]]:
    """Rows of runs that are still there; a summary that cannot be read is written anew."""
    try:
        table = read_table(folder, "summary")
    except NotARun:
        return {}
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
    files = recording.rglob("*") if recording.is_dir() else [recording]
    return sum(each.stat().st_size for each in files if each.is_file())


def _line(outcome: ReplayOutcome) -> str:
    return f"{outcome.recording}: {outcome.reason or 'done'}"
