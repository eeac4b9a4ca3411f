"""Metrics of saved runs: processor time of whole `quadlog metrics` processes over 100 runs."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from benchmarks.figures import Figure

FIXTURES = Path(__file__).parents[1] / "fixtures"
QUADLOG = str(Path(sys.executable).with_name("quadlog"))
RUNS = 100


def measure(folder: Path) -> Iterator[Figure]:
    """The committed recording's run, copied; what a table needs, and every sample that csv needs."""
    runs = _copies(_replay(folder), folder / "copies")
    imports = "import numpy, pyarrow.parquet, scipy.special, scipy.spatial.transform, pydantic"
    bare_s = min(_cpu_s([sys.executable, "-c", imports]) for _ in range(3))
    floor = f"floor: importing numpy, scipy, pyarrow and pydantic takes {bare_s:.2f} s"
    for to in ("table", "json", "csv"):
        seconds = min(_cpu_s([QUADLOG, "metrics", str(runs), "--format", to]) for _ in range(3))
        yield Figure(f"quadlog metrics, {RUNS} runs, --format {to}", seconds, "s cpu", 3, floor=floor)
        floor = ""


def _replay(folder: Path) -> Path:
    output = folder / "fixture"
    config = str(FIXTURES / "follow.toml")
    command = [QUADLOG, "replay", str(FIXTURES / "follow.mcap"), "-c", config, "-o", str(output)]
    subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)
    return output / "follow"


def _copies(run: Path, runs: Path) -> Path:
    for number in range(RUNS):
        shutil.copytree(run, runs / f"follow-{number:03d}", ignore=shutil.ignore_patterns("plots", "*.html", "*.mcap"))
    return runs


def _cpu_s(command: list[str]) -> float:
    before = os.times()
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
    after = os.times()
    return after.children_user - before.children_user + after.children_system - before.children_system
