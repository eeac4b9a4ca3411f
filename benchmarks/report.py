"""Report: pictures, charts and page of a minute's walk again, in seconds of the whole command."""

from __future__ import annotations

import statistics
import sys
from collections.abc import Iterator
from pathlib import Path

from benchmarks.figures import QUADLOG, Figure, run_quadlog, run_timed

ROUNDS = 5
SECONDS = 60
LIMIT_S, LIMIT_MB = 4.0, 1.2
# A sweep of fewer rays: how many points a scan had plays no part in a report.
AZIMUTH_STEPS = 450
MATPLOTLIB = "import matplotlib.figure, matplotlib.backends.backend_agg, matplotlib.style"


def measure(folder: Path) -> Iterator[Figure]:
    """`quadlog report RUN` in turn with importing what it draws with; the recording is made and replayed first."""
    run = _replayed(folder)
    report, alone = [QUADLOG, "report", str(run)], [sys.executable, "-c", MATPLOTLIB]
    pairs = [(run_timed(report).wall, run_timed(alone).wall) for _ in range(ROUNDS)]
    report_s, import_s = (statistics.median(pair[which] for pair in pairs) for which in (0, 1))
    floor = f"floor: importing matplotlib alone is {import_s:.2f} s, one empty panel of one picture about 0.02 s"
    yield Figure(f"quadlog report of {SECONDS} s with UWB, lidar and torques", report_s, "s", LIMIT_S, floor=floor)
    yield Figure("the same / importing matplotlib", statistics.median(both / one for both, one in pairs), "x")
    yield Figure("the same, processor time", run_timed(report).cpu, "s cpu")
    yield Figure("report.html", (run / "report.html").stat().st_size / 1e6, "MB", LIMIT_MB)


def _replayed(folder: Path) -> Path:
    recording, config, runs = folder / "follow.mcap", folder / "quadlog.toml", folder / "runs"
    make = ("synthesize", "follow", "--duration", str(SECONDS), "--azimuth-steps", str(AZIMUTH_STEPS))
    run_quadlog(*make, "-o", str(recording), "--config-output", str(config))
    run_quadlog("replay", str(recording), "-c", str(config), "-o", str(runs))
    return runs / recording.stem
