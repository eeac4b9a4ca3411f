"""Replay to the map, on one core: both methods against reading alone, and memory of whole processes."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.figures import CONFIG, FIXTURE, QUADLOG, Figure, one_core, run_apart
from benchmarks.reading import decompress

FULL_S, FULL_STEPS, SCAN_MS = 60, 1875, 100
LONGER, THIN_STEPS, MEMORY_MB = 10, 330, 350
UWB_PERIOD_NS = 100_000_000
WALLS_SEED, WALLS_SCANS = 1000, 20
ROUNDS = 3
METHODS = ("range_image", "paper")
FACTOR_LIMITS = {("range_image", "zstd"): 40.0, ("range_image", "uncompressed"): 60.0, ("paper", "zstd"): 8.0}


class Replayed(NamedTuple):
    """What one `replay --until map` took.

    factor: recorded seconds per second; scan_ms: median of classifying one.
    """

    factor: float
    scan_ms: float
    memory_mb: float


def measure(folder: Path) -> Iterator[Figure]:
    """Speed first, so that memory is measured with a full cache of compiled code."""
    os.environ["NUMBA_CACHE_DIR"] = str(folder / "compiled")
    yield from _speed(folder)
    yield from _memory(folder)
    yield from _near_walls()


def _speed(folder: Path) -> Iterator[Figure]:
    """Best of some rounds, in which the methods take turns."""
    files = {"zstd": folder / "full.mcap", "uncompressed": folder / "plain.mcap"}
    run_apart(_write, files["zstd"], FULL_S, FULL_STEPS)
    run_apart(_unpack, files["zstd"], files["uncompressed"])
    alone_s = {packed: min(run_apart(_read_alone_s, path) for _ in range(ROUNDS)) for packed, path in files.items()}
    _replay(FIXTURE, folder / "paper", "paper")  # compiles
    for packed, path in files.items():
        floor = f"floor: reading and decompressing alone, {FULL_S / alone_s[packed]:.0f} x"
        rounds = [[_replay(path, folder / "full", method) for method in METHODS] for _ in range(ROUNDS)]
        for method, replays in zip(METHODS, zip(*rounds, strict=True), strict=True):
            of = f"30 k points, {packed}, {method}"
            factor = max(each.factor for each in replays)
            yield Figure(f"{of}: to the map", factor, "x real", FACTOR_LIMITS.get((method, packed)), True, floor)
            of_it = f"of it to classify: {min(each.scan_ms for each in replays):.2f} ms"
            yield Figure(f"{of}: a scan", SCAN_MS / factor, "ms", floor=of_it)


def _memory(folder: Path) -> Iterator[Figure]:
    yield Figure("30 k points: peak memory", _replay(folder / "full.mcap", folder / "full").memory_mb, "MB", MEMORY_MB)
    short, long = folder / "short.mcap", folder / "long.mcap"
    run_apart(_write, short, FULL_S, THIN_STEPS)
    run_apart(_write, long, FULL_S * LONGER, THIN_STEPS)
    short_mb, long_mb = (_replay(path, folder / path.stem).memory_mb for path in (short, long))
    floor = f"{long_mb:.0f} MB after {FULL_S * LONGER // 60} minutes"
    yield Figure(
        f"5 k points: peak memory, {FULL_S * LONGER} s / {FULL_S} s", long_mb / short_mb, "x", 1.05, floor=floor
    )


def _near_walls() -> Iterator[Figure]:
    """How much of what either method calls ground is ground, on simulated scans of which every point is known."""
    from quadlog.lidar.classified_scan import PointClass
    from quadlog.lidar.paper_method import PaperSettings
    from quadlog.lidar.scan_classifier import RangeImageSettings, ScanClassifier
    from quadlog.messages import PointCloud
    from quadlog.simulation.synthetic.labelled_scans import labelled_scans

    settings = {"range_image": RangeImageSettings(), "paper": PaperSettings()}
    for place in ("wall_ahead", "corridor"):
        found, called = dict.fromkeys(METHODS, 0), dict.fromkeys(METHODS, 0)
        for scan in labelled_scans(place, WALLS_SEED, WALLS_SCANS):
            cloud = PointCloud(None, "", scan.xyz_lidar_m, scan.ring)
            for method in METHODS:
                made = ScanClassifier(settings[method]).classify(cloud, scan.transform_lidar_to_base)
                ground = made.point[made.label == PointClass.GROUND]
                found[method] += int(np.count_nonzero(scan.truth[ground] == PointClass.GROUND))
                called[method] += len(ground)
        for method in METHODS:
            yield Figure(f"{place}, points called ground that are, {method}", 100 * found[method] / called[method], "%")


def _replay(recording: Path, output: Path, method: str = "range_image") -> Replayed:
    """On one core where the system allows it."""
    command = [QUADLOG, "replay", str(recording), "-c", str(CONFIG), "-o", str(output), "--until", "map", "--force"]
    command += ["--set", f"lidar.method={method}"]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run(command, check=True, capture_output=True, env=environment, preexec_fn=one_core)
    record = json.loads((output / recording.stem / "run.json").read_text())
    stages = {stage["name"]: stage for stage in record["stages"]}
    return Replayed(
        factor=record["realtime_factor"],
        scan_ms=_median_ms(output / recording.stem / "scans.parquet"),
        memory_mb=stages["map"]["peak_memory_mb"],
    )


def _median_ms(table: Path) -> float:
    from pyarrow import parquet

    return statistics.median(parquet.read_table(table, columns=["ms"])["ms"].to_pylist())


def _write(path: Path, duration_s: int, azimuth_steps: int) -> None:
    """The scenario of the fixture, with ten UWB fixes a second."""
    from quadlog.pipelines.simulation.synthesize import make_recording, synthesize
    from quadlog.simulation.sensors.uwb import UwbErrors

    recording = make_recording("follow", 7, duration_s, azimuth_steps)
    synthesize(replace(recording, uwb=UwbErrors(period_ns=UWB_PERIOD_NS)), path)


def _unpack(packed: Path, plain: Path) -> None:
    """The same messages in chunks that are not compressed, with their checksums."""
    from mcap.reader import make_reader
    from mcap.writer import CompressionType, Writer

    with packed.open("rb") as source, plain.open("wb") as target:
        writer = Writer(target, compression=CompressionType.NONE, enable_crcs=True)
        writer.start(profile="ros2", library="quadlog-bench")
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(source).iter_messages():
            assert schema is not None
            if channel.id not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                named = channel.topic, channel.message_encoding, schema_id, channel.metadata
                channels[channel.id] = writer.register_channel(*named)
            stamps = message.log_time, message.data, message.publish_time, message.sequence
            writer.add_message(channels[channel.id], *stamps)
        writer.finish()


def _read_alone_s(path: Path) -> float:
    """Seconds to read and decompress every chunk."""
    before_s = time.perf_counter()
    decompress(path)
    return time.perf_counter() - before_s
