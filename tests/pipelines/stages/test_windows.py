"""One recording shared by several processes: whatever is wrong with it, the run is the one that a single one makes."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from quadlog.config_file import load_config
from quadlog.errors import ClocksDiffer
from quadlog.pipelines.engine.local_pool import LocalPool
from quadlog.pipelines.progress import Kept
from quadlog.pipelines.replay import ReplayOptions, ReplayRequest, replay
from quadlog.pipelines.stages import perceive, window_helper, window_shares, window_turns
from quadlog.pipelines.stages.first_compilation import SAID
from quadlog.pipelines.stages.scan_source import AGAIN
from quadlog.pipelines.stages.window_helper import help_with
from quadlog.pipelines.stages.window_turns import SharedScans
from quadlog.simulation.synthesized import ROBOT_TRUTH_TOPIC, START_NS

SETTINGS = [f"topics.position={ROBOT_TRUTH_TOPIC}", "topics.target=ahead", "grid.size_cells=81"]
WITH_TIMES = {"stages.json", "run.json", "report.html", "scans.parquet", "metrics.json"}
"""Files that tell how long something took; the rest of what they say is compared."""
HOW = {
    "mcap": "shared",
    "bag": "shared",
    "db3": "shared",
    "split": "shared",
    "small chunks": "shared",
    "equal log times": "shared",
    "nearly all in one window": "shared",
    "out of order": "shared",
    "a stray stamp": "again",
    "a stamp of 0": "again",
    "not to be decoded": "again",
    "a broken cloud": "again",
    "fewer than promised": "again",
    "an index that is wrong": "alone",
    "rows written late": "alone",
}
"""How several processes have the scans of each recording: shared, shared and then once more by one, or never shared."""


class Helpers(ThreadPoolExecutor):
    """Threads in place of processes."""

    begun = 0

    def __init__(self, workers: int, initializer: Any, initargs: Any) -> None:
        super().__init__(1, initializer=initializer, initargs=initargs)
        Helpers.begun += 1

    def terminate_workers(self) -> None:
        self.submit(lambda: window_helper._helper.reader._recording.close())  # as the end of a process does
        self.shutdown()


@pytest.fixture
def go(tmp_path, monkeypatch) -> Callable[..., tuple[Path, str, list[str]]]:
    """Replays to the map; returns the run, how the scans were had, and what was said."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    monkeypatch.setattr(window_shares, "WORTH_S", 1e-9)
    monkeypatch.setattr(window_shares, "WINDOW_POINTS", 8_000)
    monkeypatch.setattr(window_turns, "LocalPool", Helpers)
    monkeypatch.setattr("quadlog.pipelines.stages.report.write_plots", lambda run, record: {})
    read = SharedScans.read

    def read_once_helpers_are_ready(self: SharedScans) -> Any:
        wait(self._helpers)
        return read(self)

    monkeypatch.setattr(SharedScans, "read", read_once_helpers_are_ready)

    def replayed(recording: Path, processes: int, settings: list[str] = SETTINGS, **options: Any) -> Any:
        run, kept, begun = tmp_path / f"run-{processes}", Kept(), Helpers.begun
        chosen, config = ReplayOptions(until="map", **options), load_config(None, settings, {})
        try:
            replay(ReplayRequest(recording, run, config, chosen, processes=processes), kept)
        finally:
            assert list((tmp_path / "temporary").iterdir()) == []
        how = "again" if AGAIN in kept.lines else "shared" if Helpers.begun > begun else "alone"
        return run, how, [line for line in kept.lines if line not in (AGAIN, SAID)]

    return replayed


def assert_alike(one: Path, other: Path) -> None:
    """The same in every file but for what was measured with a clock."""
    names = {path.relative_to(one).as_posix() for path in one.rglob("*") if path.is_file()}
    assert names == {path.relative_to(other).as_posix() for path in other.rglob("*") if path.is_file()}
    assert {"maps.npz", "ground.npz", "cloud_samples.npz", "map.pgm", *WITH_TIMES} <= names
    for name in names - WITH_TIMES:
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
    tables = [pq.read_table(run / "scans.parquet").drop_columns("ms") for run in (one, other)]
    assert tables[0].equals(tables[1])
    metrics, records = ([json.loads((run / name).read_text()) for run in (one, other)] for name in _JSON)
    assert metrics[0].keys() == metrics[1].keys()
    for key in ("warnings", "losses", "counts", "notes", "topics", "config", "options", "recorded_s", "input"):
        assert json.dumps(records[0][key]) == json.dumps(records[1][key])


_JSON = ("metrics.json", "run.json")


@pytest.mark.parametrize("name", HOW)
def test_whatever_the_recording_the_run_is_the_same(name, recorded, go):
    alone, how, said = go(recorded(name), 1)
    assert how == "alone"
    shared, how, said_too = go(recorded(name), 2)
    assert how == HOW[name]
    assert said_too == said
    assert_alike(alone, shared)
    # Otherwise the two would agree on nothing.
    assert json.loads((alone / "run.json").read_text())["counts"]["scans"] >= 30


@pytest.mark.parametrize("options", [{"start_s": 0.55, "duration_s": 1.7}, {"stamp": "log"}, {"start_s": 1.0}])
def test_a_part_of_it_is_the_same_part(options, recorded, go):
    alone, _, said = go(recorded("equal log times"), 1, **options)
    shared, how, said_too = go(recorded("equal log times"), 2, **options)
    assert (how, said_too) == ("shared", said)
    assert_alike(alone, shared)
    seen_s = (pq.read_table(shared / "scans.parquet")["t_ns"].to_numpy() - START_NS) * 1e-9
    start_s, duration_s = options.get("start_s", 0.0), options.get("duration_s", 9.0)
    assert len(seen_s) > 15
    assert (seen_s >= start_s).all()
    assert (seen_s < start_s + duration_s).all()


def test_clocks_that_differ_are_an_error_as_before(recorded, go):
    errors = []
    for processes in (1, 2):
        with pytest.raises(ClocksDiffer) as caught:
            go(recorded("two clocks"), processes)
        errors.append(str(caught.value))
    assert errors[0] == errors[1]


def test_scans_of_a_real_lidar(go):
    datasets = os.environ.get("QUADLOG_DATASETS")
    if not datasets:
        pytest.skip("QUADLOG_DATASETS is not set")
    recording = Path(datasets) / "lidar_16beam" / "vlp16.mcap"
    alone, _, said = go(recording, 1, settings=["results.cloud_samples=5"])
    shared, how, said_too = go(recording, 2, settings=["results.cloud_samples=5"])
    assert (how, said_too) == ("shared", said)
    assert_alike(alone, shared)


class Deadly(LocalPool):
    """Real processes, of which the one that is given the third window ends there."""

    windows = 0

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Any:
        Deadly.windows += fn is help_with
        if fn is help_with and Deadly.windows == 3:
            return super().submit(os._exit, 9)
        return super().submit(fn, *args, **kwargs)


def test_processes_make_the_run_of_one_also_when_one_of_them_dies(recorded, go, monkeypatch):
    monkeypatch.setattr(window_turns, "LocalPool", Deadly)
    monkeypatch.setattr(SharedScans, "_work_ahead", lambda self: False)  # so that processes do all they are given
    alone, _, said = go(recorded("mcap"), 1)
    shared, _, said_too = go(recorded("mcap"), 3)
    assert Deadly.windows >= 8
    (new,) = [line for line in said_too if line not in said]
    assert "ended with code 9" in new
    assert new.endswith("this one goes on alone")
    assert_alike(alone, shared)


def test_ctrl_c_leaves_no_helper_and_no_parcel(recorded, go, monkeypatch):
    stopped, mapped = [], []

    class Stopped(Helpers):
        def terminate_workers(self) -> None:
            stopped.append(self)
            super().terminate_workers()

    def interrupt(walk: Any, scan: Any, maps: Any, built: Any) -> None:
        mapped.append(scan)
        if len(mapped) == 7:
            raise KeyboardInterrupt

    monkeypatch.setattr(window_turns, "LocalPool", Stopped)
    monkeypatch.setattr(perceive, "_map_scan", interrupt)
    with pytest.raises(KeyboardInterrupt):
        go(recorded("mcap"), 2)
    assert len(stopped) == 1
