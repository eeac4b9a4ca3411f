"""Saved runs: `quadlog metrics` over 100 of them, and `quadlog report` of a minute's walk; whole processes."""

from __future__ import annotations

import shutil
import statistics
from collections.abc import Iterator
from pathlib import Path

from benchmarks.figures import CONFIG, FIXTURE, Figure, run_python, run_quadlog, synthesize

RUNS, ROUNDS, WALK_S = 100, 5, 60
# Fewer rays: how many points a scan had plays no part in a report.
AZIMUTH_STEPS = 450


def measure(folder: Path) -> Iterator[Figure]:
    """Metrics of the committed recording's run, copied; then the report in turn with importing what it draws with."""
    run_quadlog("replay", str(FIXTURE), "-c", str(CONFIG), "-o", str(folder / "fixture"))
    for number in range(RUNS):
        ignored = shutil.ignore_patterns("plots", "*.html", "*.mcap")
        shutil.copytree(folder / "fixture" / "follow", folder / "copies" / f"follow-{number:03d}", ignore=ignored)
    imports = "import numpy, pyarrow.parquet, scipy.special, scipy.spatial.transform, pydantic"
    floor = f"floor: importing numpy, scipy, pyarrow and pydantic takes {run_python(imports).cpu:.2f} s"
    for to in ("table", "json", "csv"):
        seconds = min(run_quadlog("metrics", str(folder / "copies"), "--format", to).cpu for _ in range(3))
        yield Figure(f"quadlog metrics, {RUNS} runs, --format {to}", seconds, "s cpu", 3, floor=floor)
    recording, config = synthesize(folder, WALK_S, AZIMUTH_STEPS)
    run_quadlog("replay", str(recording), "-c", str(config), "-o", str(folder / "runs"))
    run = folder / "runs" / recording.stem
    matplotlib = "import matplotlib.figure, matplotlib.backends.backend_agg, matplotlib.style"
    pairs = [(run_quadlog("report", str(run)), run_python(matplotlib)) for _ in range(ROUNDS)]
    floor = f"floor: importing matplotlib alone is {statistics.median(alone.wall for _, alone in pairs):.2f} s"
    report_s = statistics.median(report.wall for report, _ in pairs)
    yield Figure(f"quadlog report of {WALK_S} s with UWB, lidar and torques", report_s, "s", 4.0, floor=floor)
    yield Figure("the same, processor time", statistics.median(report.cpu for report, _ in pairs), "s cpu")
    yield Figure("report.html", (run / "report.html").stat().st_size / 1e6, "MB", 1.2)
