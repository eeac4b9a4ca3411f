"""One recording of a batch, wherever it is replayed: its outcome, whatever happens to it, and what it cost."""

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

from quadlog.errors import AlreadyExists, CannotWrite, QuadlogError, RecordingNotFound
from quadlog.pipelines.batch_progress import Told
from quadlog.pipelines.engine.dask_task import Stopped
from quadlog.pipelines.engine.telling import worker_name
from quadlog.pipelines.progress import forget_peak_memory, peak_memory_mb
from quadlog.pipelines.remote_runs import replay_anywhere
from quadlog.pipelines.replay import ReplayOutcome, ReplayRequest
from quadlog.results.files import is_full
from quadlog.storage.remote_path import RemotePath

WORTH_COLLECTING_S = 5.0
"""Pictures leave rings of objects that Python finds late, with some 20 MB of each recording. To look for them takes
0.1 s: not worth it after every short one."""


@dataclass(frozen=True, slots=True)
class BatchTask:
    """number: of the recording in the batch. shared: a file that whoever writes into the output folder must see."""

    number: int
    request: ReplayRequest
    size_bytes: int
    shared: Path | None = None


@dataclass(frozen=True, slots=True)
class BatchAnswer:
    """warnings: lines of the replay. disk_full: the words of the error, when there was no room for the results."""

    outcome: ReplayOutcome
    warnings: tuple[str, ...] = ()
    disk_full: str = ""


def replay_task(task: BatchTask) -> BatchAnswer:
    """The outcome of one recording of a batch, whatever happens to it."""
    request = task.request
    told, cost = Told(task.number, request.run.name), dict[str, Any]()
    full = ""
    try:
        if task.shared is not None:
            _check_visible(request, task.shared)
        before = _finished_at(request.run)
        with _measured(task, cost):
            outcome = replay_anywhere(request, told)
        if _finished_at(request.run) == before:
            cost.clear()  # it was done already
    except Stopped:
        raise
    except AlreadyExists as error:
        outcome = ReplayOutcome.of_failure(request, str(error), refused=True)
    except MemoryError:
        outcome = ReplayOutcome.of_failure(request, f"out of memory{peak_words(peak_memory_mb())}; --resume goes on")
    except (QuadlogError, OSError) as error:
        full = " ".join(str(error).split()) if _tells_of_a_full_disk(error) else ""
        outcome = ReplayOutcome.of_failure(request, " ".join(str(error).split()))
    except Exception as error:
        traceback.print_exc(file=sys.stderr)
        outcome = ReplayOutcome.of_failure(request, f"a bug in quadlog: {type(error).__name__}: {error}")
    if cost.get("wall_s", 0.0) > WORTH_COLLECTING_S:
        gc.collect()
    return BatchAnswer(replace(outcome, cost=cost), tuple(told.warnings), full)


def peak_words(peak_mb: float | None) -> str:
    """How much memory it was, where that is known."""
    return "" if peak_mb is None else f", {peak_mb:.0f} MB at its peak"


@contextmanager
def _measured(task: BatchTask, cost: dict[str, Any]) -> Iterator[None]:
    """Fills the last columns of summary.parquet; cpu_s is the whole process's."""
    forget_peak_memory()
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    try:
        yield
    finally:
        cost |= {"wall_s": time.perf_counter() - wall_s, "cpu_s": time.process_time() - cpu_s}
        cost |= {"peak_memory_mb": peak_memory_mb(), "input_bytes": float(task.size_bytes), "worker": worker_name()}


def _check_visible(request: ReplayRequest, shared: Path) -> None:
    """Raises RecordingNotFound, CannotWrite on a worker that does not see what the one who asks sees."""
    if not request.recording.exists():
        raise RecordingNotFound(request.recording, f"is not to be seen from worker {worker_name()}; share its folder")
    if not shared.exists():
        raise CannotWrite(shared.parent, f"the folder is another one, or none, on worker {worker_name()}; share it")


def _finished_at(run: Path) -> object:
    """What changes when the run is finished anew; None when it is not finished."""
    record = run / "run.json"
    try:
        return record.look().told if isinstance(record, RemotePath) else record.stat().st_mtime_ns
    except FileNotFoundError:
        return None


def _tells_of_a_full_disk(error: BaseException | None) -> bool:
    """Whether that is the cause, or the cause's cause."""
    while error is not None:
        if isinstance(error, OSError) and is_full(error):
            return True
        error = error.__cause__
    return False
