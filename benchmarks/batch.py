"""Batch: what workers gain, and what the engine costs."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from benchmarks.figures import Figure, run_quadlog, synthesize

EQUAL, EQUAL_S, EQUAL_STEPS = 8, 60, 1800
# Short, with few rays: the engine's share is largest.
SHORT, SHORT_S, SHORT_STEPS = 1000, 2, 90


def measure(folder: Path) -> Iterator[Figure]:
    """Whole commands, with start-up and summary: equal recordings on one and two workers, then many short ones."""
    equal = _recordings(folder / "equal", EQUAL, EQUAL_S, EQUAL_STEPS)
    one_s, two_s = (_replay_s(equal, jobs, "--jobs", jobs, "--until", "map") for jobs in ("1", "2"))
    floor = f"on {os.cpu_count()} processors; {one_s:.1f} s and {two_s:.1f} s with start-up and summary"
    yield Figure(f"{EQUAL} recordings of {EQUAL_S} s, 2 workers against 1", one_s / two_s, "x", 1.8, True, floor)
    yield Figure("the same on a Dask cluster of 2 workers / 2 jobs", _on_cluster_s(equal) / two_s, "x")
    short = _recordings(folder / "short", SHORT, SHORT_S, SHORT_STEPS)
    batch_s = _replay_s(short, "1", "--jobs", "1", "--until", "ingest")
    replays_s = float(pd.read_parquet(short / "1" / "summary.parquet")["wall_s"].sum())
    floor = f"(command - sum of wall_s) / sum of wall_s, of {replays_s / SHORT * 1e3:.0f} ms each"
    yield Figure(f"engine overhead at {SHORT} short recordings", 100 * (batch_s / replays_s - 1), "%", 2, floor=floor)


def _recordings(folder: Path, count: int, duration_s: int, azimuth_steps: int) -> Path:
    """A folder with `count` links to the same recording, and its configuration."""
    made, _ = synthesize(folder, duration_s, azimuth_steps)
    for number in range(1, count):
        os.link(made, folder / f"{number}.mcap")
    return folder


def _replay_s(folder: Path, output: str, *options: str) -> float:
    words = "replay", str(folder / "*.mcap"), "-c", str(folder / "quadlog.toml"), "-o", str(folder / output)
    return run_quadlog(*words, *options).wall


def _on_cluster_s(folder: Path) -> float:
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0") as cluster:
        return _replay_s(folder, "dask", "--scheduler", cluster.scheduler_address, "--until", "map")
