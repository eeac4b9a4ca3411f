from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import quadlog
from quadlog.errors import NotARun, QuadlogError
from quadlog.results import load_maps, read_metrics


def test_tables_are_what_pandas_itself_reads(tiny_run):
    run = quadlog.load_run(tiny_run)
    assert list(run.tables) == [name for name in run.tables if (tiny_run / f"{name}.parquet").is_file()]
    assert {f"{name}.parquet" for name in run.tables} == {path.name for path in tiny_run.glob("*.parquet")}
    for name, table in run.tables.items():
        assert isinstance(table, pd.DataFrame)
        expected = pq.read_table(tiny_run / f"{name}.parquet").to_pandas()
        pd.testing.assert_frame_equal(table, expected, check_dtype=False)
        assert table.dtypes.get("t_ns", np.int64) == np.int64


def test_a_table_is_read_when_asked_for_and_once(tiny_run):
    run = quadlog.load_run(tiny_run)
    poses = run.tables["poses"]
    for path in tiny_run.glob("*.parquet"):
        path.unlink()
    assert run.tables["poses"] is poses
    with pytest.raises(KeyError, match="fixes"):
        _ = run.tables["fixes"]


def test_a_table_that_is_not_there_lists_those_that_are(tiny_run):
    (tiny_run / "control.parquet").unlink()
    tables = quadlog.load_run(tiny_run).tables
    assert "control" not in tables
    assert tables.get("control") is None
    assert len(tables) == len(list(tables))
    with pytest.raises(KeyError, match=r"control; .*walk has: fixes, ranges"):
        _ = tables["control"]
    assert "../walk/poses" not in tables
    assert "summary" not in tables


def test_record_config_and_metrics_are_those_of_the_files(tiny_run):
    run = quadlog.load_run(str(tiny_run))
    assert run.path == tiny_run
    assert run.record == json.loads((tiny_run / "run.json").read_text())
    assert run.config["planner"]["name"] == "ia_star"
    assert run.metrics == {name: each["value"] for name, each in read_metrics(tiny_run).items()}
    assert run.metrics["eta_m"] == 0.123
    assert repr(run) == f"<quadlog run {tiny_run}: {len(run.tables)} tables, {len(run.metrics)} metrics>"
    assert "poses" in repr(run.tables)


def test_maps_are_arrays(tiny_run):
    run, expected = quadlog.load_run(tiny_run), load_maps(tiny_run)
    assert run.maps is run.maps
    assert len(run.maps) == len(expected) > 0
    for ours, theirs in zip(run.maps, expected, strict=True):
        assert ours.occupied.dtype == np.bool_
        np.testing.assert_array_equal(ours.occupied, theirs.occupied)


def test_what_is_no_run_says_so(tiny_run, tmp_path):
    with pytest.raises(NotARun, match="no such folder"):
        quadlog.load_run(tmp_path / "nowhere")
    (tiny_run / "run.json").write_text("{")
    with pytest.raises(QuadlogError, match=r"run\.json: is damaged"):
        quadlog.load_run(tiny_run)


def test_damage_is_told_when_it_is_met(tiny_run):
    (tiny_run / "poses.parquet").write_bytes(b"PAR1 no table")
    (tiny_run / "maps.npz").unlink()
    (tiny_run / "metrics.json").write_text("[]")
    (tiny_run / "run.json").write_text('{"config": 3}')
    run = quadlog.load_run(tiny_run)
    for read in (lambda: run.tables["poses"], lambda: run.maps, lambda: run.metrics, lambda: run.config):
        with pytest.raises(NotARun):
            read()
    assert len(run.tables["plans"]) > 0
