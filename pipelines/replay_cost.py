"""What a replay cost, as the last columns of summary.parquet have it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from quadlog.pipelines.engine.telling import worker_name
from quadlog.pipelines.progress import forget_peak_memory, peak_memory_mb
from quadlog.storage.remote_path import RemotePath


@contextmanager
def measured(cost: dict[str, Any], run: Path, size_bytes: int) -> Iterator[None]:
    """Fills `cost` when the block ends, unless it found the run done already; cpu_s is the whole process's."""
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
    """What changes when the run is finished anew; None when it is not finished."""
    record = run / "run.json"
    try:
        return record.look().told if isinstance(record, RemotePath) else record.stat().st_mtime_ns
    except FileNotFoundError:
        return None
