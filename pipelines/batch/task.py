"""Replay one recording of a batch in a worker, and measure time and memory."""

from __future__ import annotations

import gc
import sys
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from quadlog.errors import AlreadyExists, CannotWrite, QuadlogError, RecordingNotFound, RunExists, RunOfAnother
from quadlog.pipelines.batch.progress import TaskProgress
from quadlog.pipelines.batch.remote import replay_anywhere
from quadlog.pipelines.executor.dask_cluster import Stopped
from quadlog.pipelines.executor.machine import is_out_of_memory
from quadlog.pipelines.executor.progress import forget_peak_memory, peak_memory_mb, worker_name
from quadlog.pipelines.request import ReplayOutcome, ReplayRequest
from quadlog.pipelines.stages.resume import finished_outcome
from quadlog.storage.atomic_write import is_full
from quadlog.storage.remote_path import RemotePath


@contextmanager
def measured(cost: dict[str, Any], run: Path, size_bytes: int) -> Iterator[None]:
    """Fill `cost` when the block ends, unless the run was done already; cpu_s is the whole process's."""
    before = finished_at(run)
    forget_peak_memory()
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    done_already = False
    try:
        yield
        done_already = finished_at(run) == before
    finally:
        if not done_already:
            cost |= {"wall_s": time.perf_counter() - wall_s, "cpu_s": time.process_time() - cpu_s}
            cost |= {"peak_memory_mb": peak_memory_mb(), "input_bytes": float(size_bytes), "worker": worker_name()}


def finished_at(run: Path) -> object:
    """A value that changes when the run is finished again; None when it is not finished."""
    record = run / "run.json"
    try:
        return record.look().told if isinstance(record, RemotePath) else record.stat().st_mtime_ns
    except FileNotFoundError:
        return None


WORTH_COLLECTING_S = 5.0
"""Figures leave reference cycles of some 20 MB. Collecting them takes 0.1 s, too long after every short recording."""


@dataclass(frozen=True, slots=True)
class BatchTask:
    """One recording to replay.

    number: of the recording in the batch. shared: a file that the worker must see if it shares the output folder.
    refuses: a run that another process finished meanwhile is refused; what a killed worker began of it is continued.
    """

    number: int
    request: ReplayRequest
    size_bytes: int
    shared: Path | None = None
    refuses: bool = False


@dataclass(frozen=True, slots=True)
class BatchAnswer:
    """warnings: lines of the replay. disk_full: text of the error if the disk is full."""

    outcome: ReplayOutcome
    warnings: tuple[str, ...] = ()
    disk_full: str = ""


def replay_task(task: BatchTask) -> BatchAnswer:
    """Replay one recording; every error but Stopped becomes its outcome."""
    request = task.request
    told, cost = TaskProgress(task.number, request.run.name), dict[str, Any]()
    full = ""
    try:
        if task.shared is not None:
            _check_visible(request, task.shared)
        if task.refuses:
            _refuse_finished(request)
        with measured(cost, request.run, task.size_bytes):
            outcome = replay_anywhere(request, told)
    except Stopped:
        raise
    except (AlreadyExists, RunOfAnother) as error:
        outcome = ReplayOutcome.of_failure(request, str(error), refused=True)
    except Exception as error:
        full = " ".join(str(error).split()) if _tells_of_a_full_disk(error) else ""
        outcome = ReplayOutcome.of_failure(request, _failure_words(error))
    if cost.get("wall_s", 0.0) > WORTH_COLLECTING_S:
        gc.collect()
    return BatchAnswer(replace(outcome, cost=cost), tuple(told.warnings), full)


def _failure_words(error: Exception) -> str:
    """The error in one line; for a bug its traceback is printed, too."""
    if is_out_of_memory(error):
        return out_of_memory_words(peak_memory_mb())
    if isinstance(error, (QuadlogError, OSError)):
        return " ".join(str(error).split())
    traceback.print_exception(error, file=sys.stderr)
    return f"a bug in quadlog: {type(error).__name__}: {error}"


def out_of_memory_words(peak_mb: float | None) -> str:
    """The reason of a recording whose replay ran out of memory."""
    return f"out of memory{peak_words(peak_mb)}; --resume goes on"


def peak_words(peak_mb: float | None) -> str:
    """The peak memory, if known."""
    return "" if peak_mb is None else f", {peak_mb:.0f} MB at its peak"


def _refuse_finished(request: ReplayRequest) -> None:
    """Raises AlreadyExists for a run that another process has finished since the batch began."""
    if finished_at(request.run) is not None and finished_outcome(request) is None:
        raise RunExists(request.run)


def _check_visible(request: ReplayRequest, shared: Path) -> None:
    """Raises RecordingNotFound, CannotWrite on a worker that does not share the recording's or the output folder."""
    if not request.recording.exists():
        raise RecordingNotFound(request.recording, f"is not to be seen from worker {worker_name()}; share its folder")
    if not shared.exists():
        raise CannotWrite(shared.parent, f"the folder is another one, or none, on worker {worker_name()}; share it")


def _tells_of_a_full_disk(error: BaseException | None) -> bool:
    """Whether a full disk is the error or among its causes."""
    while error is not None:
        if isinstance(error, OSError) and is_full(error):
            return True
        error = error.__cause__
    return False
