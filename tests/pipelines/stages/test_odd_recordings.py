"""Recordings with something odd about them, replayed to the map: what is read, warned of and lost."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from quadlog.config.file import load_config
from quadlog.errors import ClocksDiffer
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import ReplayOptions, ReplayRequest
from quadlog.results.tables import read_table
from quadlog.simulation.synthetic.recording import ROBOT_TRUTH_TOPIC, START_NS

SETTINGS = [f"topics.position={ROBOT_TRUTH_TOPIC}", "topics.target=ahead", "grid.size_cells=81"]
SOUND = (0, 32, "", [])
EXPECTED: dict[str, tuple[int, int, str, list[tuple[str, int]]]] = {
    "mcap": SOUND,
    "bag": SOUND,
    "db3": SOUND,
    "split": SOUND,
    "small chunks": SOUND,
    "equal log times": SOUND,
    "nearly all at once": SOUND,
    "out of order": SOUND,
    "a stray stamp": (0, 31, "/lidar/points: 1 header stamps lie more than an hour from its others", []),
    "a stamp of 0": (0, 32, "/lidar/points: 1 messages have the stamp 0", []),
    "not to be decoded": (3, 31, "", [("decode", 1)]),
    "a broken cloud": (3, 31, "", [("crc", 1)]),
    "fewer than promised": (3, 32, "", [("count", 1)]),
    "an index that is wrong": (0, 32, "the index gives wrong times for 1 chunk", []),
    "rows written late": (0, 32, "log time goes back in the file, by up to 3.100 s", []),
}
"""Exit code, scans, how the only warning begins, and cause and count of each loss."""


@pytest.fixture
def go(tmp_path) -> Callable[..., Path]:
    def replayed(recording: Path, **options: Any) -> tuple[int, Path]:
        run = tmp_path / "run"
        chosen = ReplayOptions(until="map", **options)
        request = ReplayRequest(recording, run, load_config(None, SETTINGS, {}), chosen, plots=False)
        return replay(request, Silent()).exit_code, run

    return replayed


@pytest.mark.parametrize("name", EXPECTED)
def test_what_is_read_and_what_is_lost(name, recorded, go):
    exit_code, run = go(recorded(name))
    record = json.loads((run / "run.json").read_text())
    losses = [(loss["cause"], loss["count"]) for loss in record["losses"]]
    expected_code, scans, warning, expected_losses = EXPECTED[name]
    assert (exit_code, losses) == (expected_code, expected_losses)
    assert record["counts"]["scans"] == len(read_table(run, "scans")["t_ns"]) == scans
    assert [each[: len(warning)] for each in record["warnings"]] == ([warning] if warning else [])
    if recorded(name).is_file():
        assert record["input"]["sha256"] == hashlib.sha256(recorded(name).read_bytes()).hexdigest()


@pytest.mark.parametrize("options", [{"start_s": 0.55, "duration_s": 1.7}, {"stamp": "log"}, {"start_s": 1.0}])
def test_a_part_of_a_recording(options, recorded, go):
    _, run = go(recorded("equal log times"), **options)
    seen_s = (read_table(run, "scans")["t_ns"] - START_NS) * 1e-9
    start_s = options.get("start_s", 0.0)
    assert len(seen_s) > 15
    assert seen_s.min() >= start_s
    assert seen_s.max() < start_s + options.get("duration_s", 9.0)


def test_two_clocks_are_refused(recorded, go):
    with pytest.raises(ClocksDiffer, match="header stamps of /lidar/points lie 4200 s apart"):
        go(recorded("two clocks"))
