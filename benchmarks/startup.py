"""Start-up: of the command line alone, of a replay to its first scan, and of the very first one, which compiles."""

from __future__ import annotations

import json
import os
import statistics
from collections.abc import Iterator
from pathlib import Path

from benchmarks.figures import CONFIG, FIXTURE, QUADLOG, Figure, Seconds, run_python, run_quadlog, run_timed
from quadlog.pipelines.executor.machine import cores

ROUNDS, REPLAYS = 15, 3


def measure(folder: Path) -> Iterator[Figure]:
    """`quadlog --help` against `python -c pass`, medians of pairs; then replays of the committed recording."""
    pairs = [(run_quadlog("--help").cpu, run_python("pass").cpu, run_python("import click").cpu) for _ in range(ROUNDS)]
    help_ms, bare_ms, click_ms = (1e3 * statistics.median(each) for each in zip(*pairs, strict=True))
    floor = f"floor: importing click alone is {click_ms - bare_ms:.0f} ms above"
    yield Figure("quadlog --help, above python -c pass", help_ms - bare_ms, "ms cpu", 60, floor=floor)
    (first_s, first_cpu_s), *later = [_replay(folder) for _ in range(REPLAYS + 1)]
    later_s, later_cpu_s = (statistics.median(each) for each in zip(*later, strict=True))
    floor = f"floor: {first_cpu_s - later_cpu_s:.1f} s of compiling, over {cores()} cores"
    yield Figure("first start of make demo, above a later one", first_s - later_s, "s", 8, floor=floor)
    window = ("--until", "filter", "--duration", "0.15")  # one scan or two
    seconds = [_replay(folder, *window)[0] - _report_s(folder) for _ in range(REPLAYS + 1)]
    imports_s = run_python("import numba, numpy, pyarrow.parquet, pydantic").cpu
    floor = f"floor: importing numba, numpy, pyarrow and pydantic, {imports_s:.2f} s"
    yield Figure("later start, to the first scan", statistics.median(seconds[1:]), "s", 1.5, floor=floor)


def _replay(folder: Path, *options: str) -> Seconds:
    """A replay that keeps its compiled code below the folder."""
    environ = os.environ | {"NUMBA_CACHE_DIR": str(folder / "compiled")}
    command = [QUADLOG, "replay", str(FIXTURE), "-c", str(CONFIG)]
    return run_timed([*command, "-o", str(folder / "started"), "--force", *options], environ)


def _report_s(folder: Path) -> float:
    """Seconds that the last replay took for its metrics, pictures and page."""
    record = json.loads((folder / "started" / "follow" / "run.json").read_text())
    return next(stage["seconds"] for stage in record["stages"] if stage["name"] == "report")
