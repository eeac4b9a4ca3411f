"""Start-up: of the command line alone, of a replay to its first scan, and of the very first one, which compiles."""

from __future__ import annotations

import json
import os
import statistics
import sys
from collections.abc import Iterator
from pathlib import Path

from benchmarks.figures import CONFIG, FIXTURE, QUADLOG, Figure, Seconds, run_timed
from quadlog.pipelines.executor.machine import cores

ROUNDS, REPLAYS = 15, 3


def measure(folder: Path) -> Iterator[Figure]:
    """`quadlog --help` against `python -c pass`, medians of pairs; then replays of the committed recording."""
    pairs = [(_cpu_ms([QUADLOG, "--help"]), _cpu_ms([sys.executable, "-c", "pass"])) for _ in range(ROUNDS)]
    click_ms = statistics.median(_cpu_ms([sys.executable, "-c", "import click"]) for _ in range(ROUNDS))
    bare_ms = statistics.median(bare for _, bare in pairs)
    extra_ms = statistics.median(help_ms - bare for help_ms, bare in pairs)
    floor = f"floor: importing click alone is {click_ms - bare_ms:.0f} ms above"
    yield Figure("quadlog --help, above python -c pass", extra_ms, "ms cpu", 60, floor=floor)
    yield _first_start(folder)
    yield _first_scan(folder)


def _first_start(folder: Path) -> Figure:
    """With an empty cache of compiled code, then with a full one."""
    (first_s, first_cpu_s), *later = [_replay(folder) for _ in range(REPLAYS + 1)]
    later_s, later_cpu_s = (statistics.median(each) for each in zip(*later, strict=True))
    compiling_s = first_cpu_s - later_cpu_s
    floor = f"floor: {compiling_s:.1f} s of compiling, over {cores()} cores {compiling_s / cores():.1f} s"
    return Figure("first start of make demo, above a later one", first_s - later_s, "s", 8, floor=floor)


def _first_scan(folder: Path) -> Figure:
    """The whole process but for its report, for a window that holds one scan or two."""
    seconds = [
        _replay(folder, "--until", "filter", "--duration", "0.15")[0] - _report_s(folder) for _ in range(REPLAYS + 1)
    ]
    imports = "import numba, numpy, pyarrow.parquet, pydantic"
    floor_s = statistics.median(_cpu_ms([sys.executable, "-c", imports]) for _ in range(REPLAYS)) * 1e-3
    floor = f"floor: importing numba, numpy, pyarrow and pydantic, {floor_s:.2f} s"
    return Figure("later start, to the first scan", statistics.median(seconds[1:]), "s", 1.5, floor=floor)


def _replay(folder: Path, *options: str) -> Seconds:
    """A replay that keeps its compiled code below the folder."""
    environ = os.environ | {"NUMBA_CACHE_DIR": str(folder / "compiled")}
    command = [QUADLOG, "replay", str(FIXTURE), "-c", str(CONFIG)]
    return run_timed([*command, "-o", str(folder / "started"), "--force", *options], environ)


def _report_s(folder: Path) -> float:
    """Seconds that the last replay took for its metrics, pictures and page."""
    record = json.loads((folder / "started" / "follow" / "run.json").read_text())
    return next(stage["seconds"] for stage in record["stages"] if stage["name"] == "report")


def _cpu_ms(command: list[str]) -> float:
    return run_timed(command).cpu * 1e3
