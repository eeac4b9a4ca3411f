"""Remote recordings: what a time window transfers, counted at the server, and what the way there costs."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from pathlib import Path

from mcap.reader import make_reader

from benchmarks.figures import Figure, run_apart
from benchmarks.web_server import serve
from quadlog.config.schema import Config
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayRequest
from quadlog.storage.remote_path import to_path

LENGTH_S, AZIMUTH_STEPS = 60.0, 1800
WINDOW = ReplayOptions(start_s=27.0, duration_s=6.0, until="map")
ROUNDS = 3


def measure(folder: Path) -> Iterator[Figure]:
    """A tenth of a minute's recording, replayed up to the map through a web server on this machine and without one."""
    served = folder / "served"
    served.mkdir()
    path = run_apart(write_recording, served / "follow.mcap")
    size = path.stat().st_size
    with serve(served) as server:
        there = to_path(f"{server.url}/{path.name}")
        _replay_s(path, folder)  # compiles, and loads what is loaded once
        _replay_s(there, folder)
        server.forget()
        pairs = [(_replay_s(there, folder), _replay_s(path, folder)) for _ in range(ROUNDS)]
        share = 100 * server.sent_bytes / ROUNDS / size
        requests = len(server.requests) / ROUNDS
    floor = f"floor: chunks of the window are {100 * _window_bytes(path) / size:.1f} % of {size / 1e6:.0f} MB"
    yield Figure("10 % window of a remote MCAP, share of its bytes", share, "%", 15.0, floor=floor)
    yield Figure("requests for it", requests, "")
    yield Figure("its replay, remote / local", statistics.median(far / near for far, near in pairs), "x")


def write_recording(path: Path) -> Path:
    """A minute of the scenario `follow`, as `quadlog synthesize` writes it."""
    from quadlog.pipelines.simulation.synthesize import make_recording, synthesize

    synthesize(make_recording("follow", 1, LENGTH_S, AZIMUTH_STEPS), path)
    return path


def _replay_s(recording: Path, folder: Path) -> float:
    request = ReplayRequest(recording, folder / "run", Config(), WINDOW, Existing.FORCE)
    began_s = time.perf_counter()
    replay(request, Silent())
    return time.perf_counter() - began_s


def _window_bytes(path: Path) -> int:
    """Bytes of the chunks that hold any message of the window: less cannot be read."""
    assert WINDOW.start_s is not None
    assert WINDOW.duration_s is not None
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    start_ns = summary.statistics.message_start_time + round(WINDOW.start_s * 1e9)
    end_ns = start_ns + round(WINDOW.duration_s * 1e9)
    return sum(
        chunk.chunk_length
        for chunk in summary.chunk_indexes
        if chunk.message_end_time >= start_ns and chunk.message_start_time < end_ns
    )
