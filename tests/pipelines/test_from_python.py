"""`quadlog.replay`: the command's results, from Python, without its words."""

from __future__ import annotations

import json

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

pytestmark = pytest.mark.usefixtures("without_pictures")
SHORT = ["--duration", "1.5", "--until", "plan", "--seed", "3"]


@pytest.fixture(scope="module")
def replayed(tmp_path_factory, fixtures):
    output = tmp_path_factory.mktemp("runs")
    config, settings = fixtures / "follow.toml", {"planner.name": "astar", "grid": {"size_cells": np.int64(120)}}
    run = quadlog.replay(
        str(fixtures / "follow.mcap"), config=config, settings=settings, output=output,
        duration_s=np.float32(1.5), until="plan", seed=np.int64(3), plots=False,
    )  # fmt: skip
    assert not (run.path / "plots").exists()
    return run, output


def test_it_leaves_what_the_command_leaves(replayed, tmp_path, fixtures):
    run, output = replayed
    words = ["replay", str(fixtures / "follow.mcap"), "-c", str(fixtures / "follow.toml"), *SHORT]
    words += ["--planner", "astar", "--set", "grid.size_cells=120", "-o", str(tmp_path)]
    assert run_command(words) == 0
    command = quadlog.load_run(tmp_path / "follow")
    assert {path.name for path in run.path.iterdir()} == {path.name for path in command.path.iterdir()}
    for path in run.path.glob("*.parquet"):
        tables = [each.table(path.stem).drop(columns=["ms", "us"], errors="ignore") for each in (run, command)]
        pd.testing.assert_frame_equal(*tables)
    assert (run.path / "maps.npz").read_bytes() == (command.path / "maps.npz").read_bytes()
    assert (run.path / "config.toml").read_bytes() == (command.path / "config.toml").read_bytes()
    assert (run.record.options, run.record.input) == (command.record.options, command.record.input)
    assert run.record.command[0] == "quadlog.replay"
    assert (output / "summary.parquet").is_file()


def test_it_is_loaded(replayed):
    run, output = replayed
    assert run.path == output / "follow"
    assert set(run.table("plans")["planner"]) == {"astar"}
    assert run.maps.shape == (120, 120)
    assert run.config.grid.size_cells == 120


def test_its_row_of_the_summary_has_what_it_took_and_again_when_it_is_replaced(fixtures, tmp_path):
    for force in (False, True):
        options = {"output": tmp_path, "duration_s": 1.0, "until": "ingest", "force": force}
        run = quadlog.replay(fixtures / "follow.mcap", config=fixtures / "follow.toml", **options)
        (row,) = pd.read_parquet(tmp_path / "summary.parquet").to_dict("records")
        record = run.record
        assert row["wall_s"] == record.startup_s + sum(stage.seconds for stage in record.stages)
        assert row["peak_memory_mb"] > 0
        assert row["input_bytes"] == (fixtures / "follow.mcap").stat().st_size


def test_a_run_that_is_there_needs_force_or_resume(replayed, fixtures):
    run, output = replayed
    same = {"config": fixtures / "follow.toml", "settings": {"planner.name": "astar", "grid.size_cells": 120}}
    same |= {"output": output, "duration_s": 1.5, "until": "plan", "seed": 3}
    before = (run.path / "run.json").read_bytes()
    with pytest.raises(AlreadyExists):
        quadlog.replay(fixtures / "follow.mcap", **same)
    again = quadlog.replay(fixtures / "follow.mcap", resume=True, **same)
    assert (again.path / "run.json").read_bytes() == before


def test_nothing_is_printed(tmp_path, fixtures, capfd):
    quadlog.replay(
        fixtures / "follow.mcap", config=fixtures / "follow.toml", output=tmp_path, duration_s=1, until="ingest"
    )
    assert capfd.readouterr() == ("", "")
    assert json.loads((tmp_path / "follow" / "run.json").read_text())["options"]["until"] == "ingest"


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"until": "planning"}, UnknownName, "unknown stage 'planning'; choose one of: control, filter"),
        ({"stamp": "bag"}, UnknownName, "unknown stamp 'bag'; choose one of: header, log"),
        ({"preset": "best"}, UnknownName, "unknown preset"),
        ({"start_s": -1}, UsageError, "start_s is -1"),
        ({"start_s": float("nan")}, UsageError, "start_s is nan"),
        ({"duration_s": 0}, UsageError, "duration_s is 0"),
        ({"seed": -1}, UsageError, "seed is -1"),
        ({"seed": 2**32}, UsageError, "seed is 4294967296"),
        ({"force": True, "resume": True}, UsageError, "exclude each other"),
        ({"settings": {"planner.nme": "astar"}}, UnknownConfigKey, "settings: unknown key planner.nme"),
        ({"settings": {"planner": {"name": "nobody"}}}, InvalidConfigValue, "settings: planner.name: there is no such"),
        ({"settings": {"grid.cell_m": "wide"}}, InvalidConfigValue, "settings: grid.cell_m"),
        ({"recording": "no.mcap"}, RecordingNotFound, "no.mcap"),
    ],
)
def test_what_a_caller_can_mend_is_one_line(tmp_path, fixtures, options, error, said):
    request = {"recording": fixtures / "follow.mcap", "output": tmp_path / "runs", **options}
    with pytest.raises(error) as raised:
        quadlog.replay(**request)
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)
    assert not list(tmp_path.glob("runs/*/*"))


def test_settings_count_more_than_the_file_and_the_environment(tmp_path, fixtures, monkeypatch):
    monkeypatch.setenv("QUADLOG_GRID__CELL_M", "0.3")
    config = tmp_path / "own.toml"
    config.write_text((fixtures / "follow.toml").read_text() + "\n[grid]\ncell_m = 0.2\nmin_points = 2\n")
    run = quadlog.replay(
        fixtures / "follow.mcap", config=config, settings={"grid.cell_m": 0.25},
        output=tmp_path / "runs", duration_s=1, until="ingest",
    )  # fmt: skip
    assert run.config.grid.cell_m == 0.25
    assert run.config.grid.min_points == 2
