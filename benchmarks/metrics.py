"""Metrics of saved runs: processor time of whole `quadlog metrics` processes over 100 runs."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from benchmarks.figures import CONFIG, FIXTURE, Figure, run_quadlog, run_timed

RUNS = 100


def measure(folder: Path) -> Iterator[Figure]:
    """The committed recording's run, copied; what a table needs, and every sample that csv needs."""
    run_quadlog("replay", str(FIXTURE), "-c", str(CONFIG), "-o", str(folder / "fixture"))
    runs = _copies(folder / "fixture" / "follow", folder / "copies")
    imports = "import numpy, pyarrow.parquet, scipy.special, scipy.spatial.transform, pydantic"
    bare_s = min(run_timed([sys.executable, "-c", imports]).cpu for _ in range(3))
    floor = f"floor: importing numpy, scipy, pyarrow and pydantic takes {bare_s:.2f} s"
    for to in ("table", "json", "csv"):
        seconds = min(run_quadlog("metrics", str(runs), "--format", to).cpu for _ in range(3))
        yield Figure(f"quadlog metrics, {RUNS} runs, --format {to}", seconds, "s cpu", 3, floor=floor)
        floor = ""


def _copies(run: Path, runs: Path) -> Path:
    for number in range(RUNS):
        shutil.copytree(run, runs / f"follow-{number:03d}", ignore=shutil.ignore_patterns("plots", "*.html", "*.mcap"))
    return runs
