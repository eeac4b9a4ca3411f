"""Batch: what workers gain, what the engine costs, and that neither changes a result."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pyarrow.parquet as pq

from benchmarks.figures import Figure, run_quadlog

EQUAL, EQUAL_S = 8, 60
SHORT, SHORT_S = 1000, 2
# Fewer rays make a recording small, so that the engine's share is largest.
AZIMUTH_STEPS = 90
TIMINGS = ("ms", "us")


def measure(folder: Path) -> Iterator[Figure]:
    """Whole commands, with start-up and summary: equal recordings on one and two workers, then many short ones."""
    equal = _recordings(folder / "equal", EQUAL, EQUAL_S, ())
    one_s = _replay(equal, "one", "--jobs", "1", "--until", "map")
    two_s = _replay(equal, "two", "--jobs", "2", "--until", "map")
    floor = f"on {os.cpu_count()} processors; {one_s:.1f} s and {two_s:.1f} s with start-up and summary"
    yield Figure(f"{EQUAL} recordings of {EQUAL_S} s, 2 workers against 1", one_s / two_s, "x", 1.8, True, floor)
    one, two = (_peak_mb(equal / name) for name in ("one", "two"))
    single = equal / "single" / "0"
    _replay(equal, "single", "--until", "map", recording="0.mcap")
    yield Figure("peak memory of a worker / of a single replay", max(two) / _peak_mb(single.parent)[0], "x", 1.1)
    yield Figure("peak memory of a worker after 8 replays / its first", max(one) / one[0], "x")
    cluster_s = _on_cluster(equal)
    yield Figure("the same on a Dask cluster of 2 workers / 2 jobs", cluster_s / two_s, "x")
    differing = _differing(equal / "one", equal / "two") + _differing(equal / "one", equal / "dask")
    yield Figure("files that differ between --jobs 1, --jobs 2 and Dask", len(differing), "files", 0)
    yield from _engine(_recordings(folder / "short", SHORT, SHORT_S, ("--azimuth-steps", str(AZIMUTH_STEPS))))


def _engine(short: Path) -> Iterator[Figure]:
    """All of a batch that is not within a replay: plan, hand out, progress, take in, summary and report."""
    batch_s = _replay(short, "one", "--jobs", "1", "--until", "ingest")
    replays_s = float(_summary(short / "one")["wall_s"].sum())
    floor = f"(command - sum of wall_s) / sum of wall_s, of {replays_s / SHORT * 1e3:.0f} ms each"
    yield Figure(f"engine overhead at {SHORT} short recordings", 100 * (batch_s / replays_s - 1), "%", 2, floor=floor)
    peak_mb = _peak_mb(short / "one")
    yield Figure(f"peak memory, last of {SHORT} / the tenth", peak_mb[-1] / peak_mb[9], "x")


def _recordings(folder: Path, count: int, seconds: int, options: tuple[str, ...]) -> Path:
    """A folder with `count` links to the same recording, and its configuration."""
    folder.mkdir()
    make = ["synthesize", "follow", "--duration", str(seconds), *options, "-o", str(folder / "0.mcap")]
    run_quadlog(*make, "--config-output", str(folder / "quadlog.toml"))
    for number in range(1, count):
        os.link(folder / "0.mcap", folder / f"{number}.mcap")
    return folder


def _replay(folder: Path, output: str, *options: str, recording: str = "*.mcap") -> float:
    """Seconds of the command."""
    words = "replay", str(folder / recording), "-c", str(folder / "quadlog.toml"), "-o", str(folder / output)
    return run_quadlog(*words, *options).wall


def _on_cluster(folder: Path) -> float:
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0") as cluster:
        return _replay(folder, "dask", "--scheduler", cluster.scheduler_address, "--until", "map")


def _summary(folder: Path) -> pd.DataFrame:
    return pd.read_parquet(folder / "summary.parquet")


def _peak_mb(runs: Path) -> list[float]:
    """Of each run, in the order they were finished, by its own record."""
    records = sorted(runs.glob("*/run.json"), key=lambda path: path.stat().st_mtime_ns)
    return [max(stage["peak_memory_mb"] for stage in json.loads(path.read_text())["stages"]) for path in records]


def _differing(one: Path, two: Path) -> list[Path]:
    """Tables, maps and paths of all runs that are not the same, timings apart."""
    names = [path.relative_to(one) for kind in ("parquet", "npz", "tum", "pgm") for path in one.glob(f"*/*.{kind}")]
    assert names
    return [name for name in names if not _same(one / name, two / name)]


def _same(one: Path, two: Path) -> bool:
    if one.suffix != ".parquet":
        return one.read_bytes() == two.read_bytes()
    first, second = (pq.read_table(path) for path in (one, two))
    columns = [name for name in first.column_names if name not in TIMINGS]
    return bool(first.select(columns).equals(second.select(columns)))
