"""Replay to the map, on one core: real-time factor and peak memory of whole processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from benchmarks.figures import Figure

ROOT = Path(__file__).parents[1]
QUADLOG = str(Path(sys.executable).with_name("quadlog"))
CONFIG = ROOT / "fixtures" / "follow.toml"
FIXTURE_S, FIXTURE_STEPS, FULL_STEPS = 12, 330, 1875
LONGER = 5


def measure(folder: Path) -> Iterator[Figure]:
    """The committed recording, one with full scans, and one five times as long."""
    fixture = ROOT / "fixtures" / "follow.mcap"
    full = _synthesize(folder / "full.mcap", FIXTURE_S, FULL_STEPS)
    long = _synthesize(folder / "long.mcap", FIXTURE_S * LONGER, FIXTURE_STEPS)
    _replay(fixture, folder / "warm")  # compiles, so that the figures are of compiled code
    factor, memory_mb = _replay(fixture, folder / "fixture")
    yield Figure("fixture, 5 k points a scan, paper's method", factor, "x real", 5, at_least=True)
    yield Figure("fixture, peak memory", memory_mb, "MB", 700)
    full_factor, _ = _replay(full, folder / "full")
    yield Figure("30 k points a scan, paper's method", full_factor, "x real", 3, at_least=True)
    _, long_mb = _replay(long, folder / "long")
    yield Figure(f"peak memory, {LONGER}x as long / fixture", long_mb / memory_mb, "x", 1.1)


def _synthesize(path: Path, duration_s: int, azimuth_steps: int) -> Path:
    options = ["--duration", str(duration_s), "--azimuth-steps", str(azimuth_steps), "--seed", "7"]
    subprocess.run([QUADLOG, "synthesize", "follow", "-o", str(path), *options], check=True, capture_output=True)
    return path


def _replay(recording: Path, output: Path) -> tuple[float, float]:
    """Real-time factor and peak MB of `replay --until map`, held to one core where the system allows it."""
    command = [QUADLOG, "replay", str(recording), "-c", str(CONFIG), "-o", str(output), "--until", "map"]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run(command, check=True, capture_output=True, env=environment, preexec_fn=_one_core)
    record = json.loads((output / recording.stem / "run.json").read_text())
    stages = {stage["name"]: stage for stage in record["stages"]}
    return record["realtime_factor"], stages["map"]["peak_memory_mb"]


def _one_core() -> None:
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
