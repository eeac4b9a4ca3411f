"""`quadlog.replay`: the command's results, from Python, without its words."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import quadlog
from quadlog.cli.main import run as run_command
from quadlog.errors import (
    AlreadyExists,
    InvalidConfigValue,
    RecordingNotFound,
    UnknownConfigKey,
    UnknownName,
    UsageError,
)
from tests.pipelines.conftest import FIXTURES

FOLLOW, CONFIG = FIXTURES / "follow.mcap", FIXTURES / "follow.toml"
SETTINGS = {"planner.name": "astar", "grid": {"size_cells": np.int64(120)}}
SHORT = {"config": CONFIG, "settings": SETTINGS, "duration_s": np.float32(1.5), "until": "plan", "seed": np.int64(3)}


def test_it_leaves_what_the_command_leaves_prints_nothing_and_needs_force_or_resume(tmp_path, capfd):
    run = quadlog.replay(str(FOLLOW), output=tmp_path / "runs", plots=False, **SHORT)
    assert capfd.readouterr() == ("", "")
    words = ["replay", str(FOLLOW), "-c", str(CONFIG), "-o", str(tmp_path), "--planner", "astar", "--no-plots"]
    words += ["--set", "grid.size_cells=120", *["--duration", "1.5", "--until", "plan", "--seed", "3"]]
    assert run_command(words) == 0
    command = quadlog.load_run(tmp_path / "follow")
    assert {path.name for path in run.path.iterdir()} == {path.name for path in command.path.iterdir()}
    for path in run.path.glob("*.parquet"):
        tables = [each.table(path.stem).drop(columns=["ms", "us"], errors="ignore") for each in (run, command)]
        pd.testing.assert_frame_equal(*tables)
    for name in ("maps.npz", "config.toml"):
        assert (run.path / name).read_bytes() == (command.path / name).read_bytes()
    assert (run.record.options, run.record.input) == (command.record.options, command.record.input)
    assert run.record.command[0] == "quadlog.replay"
    assert (run.path, run.maps.shape, run.config.grid.size_cells) == (tmp_path / "runs" / "follow", (120, 120), 120)
    before = (run.path / "run.json").read_bytes()
    with pytest.raises(AlreadyExists):
        quadlog.replay(FOLLOW, output=tmp_path / "runs", **SHORT)
    again = quadlog.replay(FOLLOW, output=tmp_path / "runs", resume=True, **SHORT)
    assert (again.path / "run.json").read_bytes() == before


def test_its_row_of_the_summary_has_what_it_took_and_again_when_it_is_replaced(tmp_path):
    for force in (False, True):
        run = quadlog.replay(FOLLOW, config=CONFIG, output=tmp_path, duration_s=1.0, until="ingest", force=force)
        (row,) = pd.read_parquet(tmp_path / "summary.parquet").to_dict("records")
        assert row["wall_s"] == run.record.startup_s + sum(stage.seconds for stage in run.record.stages)
        assert (row["peak_memory_mb"] > 0, row["input_bytes"]) == (True, FOLLOW.stat().st_size)


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"until": "planning"}, UnknownName, "choose one of: control, filter"),
        ({"stamp": "bag"}, UnknownName, "choose one of: auto, header, log"),
        ({"preset": "best"}, UnknownName, "unknown preset"),
        ({"start_s": float("nan")}, UsageError, "start_s is nan"),
        ({"duration_s": 0}, UsageError, "duration_s is 0"),
        ({"seed": 2**32}, UsageError, "seed is 4294967296"),
        ({"force": True, "resume": True}, UsageError, "exclude each other"),
        ({"settings": {"planner.nme": "astar"}}, UnknownConfigKey, "settings: unknown key planner.nme"),
        ({"settings": {"grid.cell_m": "wide"}}, InvalidConfigValue, "settings: grid.cell_m"),
        ({"recording": "no.mcap"}, RecordingNotFound, "no.mcap"),
    ],
)
def test_what_a_caller_can_mend_is_one_line(tmp_path, options, error, said):
    request = {"recording": FOLLOW, "output": tmp_path / "runs", **options}
    with pytest.raises(error) as raised:
        quadlog.replay(**request)
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)
    assert not list(tmp_path.glob("runs/*/*"))
