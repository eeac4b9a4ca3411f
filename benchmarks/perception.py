"""Replay to the map, on one core: both methods against reading alone, memory of whole processes, ground near walls."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.figures import CONFIG, FIXTURE, QUADLOG, Figure, one_core, run_apart, synthesize
from benchmarks.reading import decompress

FULL_S, FULL_STEPS = 60, 1875
LONGER, THIN_STEPS, MEMORY_MB = 10, 330, 350
WALLS_SEED, WALLS_SCANS = 1000, 20
ROUNDS = 3
FACTOR_LIMITS = {"range_image": 40.0, "paper": 8.0}


class Replayed(NamedTuple):
    """What one `replay --until map` took. factor: recorded seconds per second."""

    factor: float
    memory_mb: float


def measure(folder: Path) -> Iterator[Figure]:
    """Speed first, best of some rounds in which the methods take turns; then memory, with a full cache of code."""
    os.environ["NUMBA_CACHE_DIR"] = str(folder / "compiled")
    full, _ = synthesize(folder, FULL_S, FULL_STEPS)
    alone_s = min(run_apart(_read_alone_s, full) for _ in range(ROUNDS))
    _replay(FIXTURE, folder / "paper", "paper")  # compiles
    rounds = [{method: _replay(full, folder / "full", method) for method in FACTOR_LIMITS} for _ in range(ROUNDS)]
    floor = f"floor: reading and decompressing alone, {FULL_S / alone_s:.0f} x"
    for method, limit in FACTOR_LIMITS.items():
        factor = max(each[method].factor for each in rounds)
        yield Figure(f"30 k points, zstd, {method}: to the map", factor, "x real", limit, True, floor)
    memory_mb = max(each["range_image"].memory_mb for each in rounds)
    yield Figure("30 k points: peak memory", memory_mb, "MB", MEMORY_MB)
    lengths_s = (FULL_S, FULL_S * LONGER)
    thin = [synthesize(folder / "thin", length_s, THIN_STEPS)[0] for length_s in lengths_s]
    short_mb, long_mb = (_replay(path, folder / "thin").memory_mb for path in thin)
    name = f"5 k points: peak memory, {lengths_s[1]} s / {lengths_s[0]} s"
    yield Figure(name, long_mb / short_mb, "x", 1.05, floor=f"{long_mb:.0f} MB after {lengths_s[1] // 60} minutes")
    yield from _near_walls()


def _near_walls() -> Iterator[Figure]:
    """How much of what either method calls ground is ground, on simulated scans of which every point is known."""
    from quadlog.lidar.classified_scan import PointClass
    from quadlog.lidar.paper_method import PaperSettings
    from quadlog.lidar.scan_classifier import RangeImageSettings, ScanClassifier
    from quadlog.messages import PointCloud
    from tests.lab.labelled_scans import labelled_scans

    settings = {"range_image": RangeImageSettings(), "paper": PaperSettings()}
    for place in ("wall_ahead", "corridor"):
        found, called = dict.fromkeys(FACTOR_LIMITS, 0), dict.fromkeys(FACTOR_LIMITS, 0)
        for scan in labelled_scans(place, WALLS_SEED, WALLS_SCANS):
            cloud = PointCloud(None, "", scan.xyz_lidar_m, scan.ring)
            for method in found:
                made = ScanClassifier(settings[method]).classify(cloud, scan.transform_lidar_to_base)
                ground = made.returns.label == PointClass.GROUND
                found[method] += int(np.count_nonzero(scan.truth[ground] == PointClass.GROUND))
                called[method] += int(np.count_nonzero(ground))
        for method in found:
            yield Figure(f"{place}, points called ground that are, {method}", 100 * found[method] / called[method], "%")


def _replay(recording: Path, output: Path, method: str = "range_image") -> Replayed:
    """On one core where the system allows it."""
    command = [QUADLOG, "replay", str(recording), "-c", str(CONFIG), "-o", str(output), "--until", "map", "--force"]
    command += ["--set", f"lidar.method={method}"]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run(command, check=True, capture_output=True, env=environment, preexec_fn=one_core)
    record = json.loads((output / recording.stem / "run.json").read_text())
    stages = {stage["name"]: stage for stage in record["stages"]}
    return Replayed(record["realtime_factor"], stages["map"]["peak_memory_mb"])


def _read_alone_s(path: Path) -> float:
    """Seconds to read and decompress every chunk."""
    before_s = time.perf_counter()
    decompress(path)
    return time.perf_counter() - before_s
