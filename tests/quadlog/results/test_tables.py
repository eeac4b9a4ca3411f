from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as stn

from quadlog.errors import NotARun, TooLarge
from quadlog.results import tables
from quadlog.results.tables import COST_NAMES, TABLES, TableWriter, read_table, write_table


def poses(n: int) -> dict[str, Any]:
    names = ("x_m", "y_m", "yaw_rad", "z_m", "roll_rad", "pitch_rad")
    random = np.random.default_rng(0).random((6, n))
    return {"t_ns": np.arange(n), "source": ["uwb"] * n} | dict(zip(names, random, strict=True))


def cut(columns: dict[str, Any], first: int, last: int) -> dict[str, Any]:
    return {name: values[first:last] for name, values in columns.items()}


@given(
    t_ns=stn.arrays(np.int64, st.shared(st.integers(0, 40), key="n")),
    x_m=stn.arrays(
        np.float64, st.shared(st.integers(0, 40), key="n"), elements=st.floats(-1e149, 1e149) | st.just(np.nan)
    ),
    source=stn.arrays(object, st.shared(st.integers(0, 40), key="n"), elements=st.text(st.characters(codec="utf-8"))),
)
def test_any_table_comes_back(tmp_path_factory: pytest.TempPathFactory, t_ns: Any, x_m: Any, source: Any) -> None:
    run = tmp_path_factory.mktemp("run")
    write_table(
        run / "target.parquet", TABLES["target"], {"t_ns": t_ns, "x_m": x_m, "y_m": x_m[::-1], "source": source}
    )
    back = read_table(run, "target")
    assert list(back) == ["t_ns", "x_m", "y_m", "source"]
    assert back["t_ns"].dtype == np.int64
    np.testing.assert_array_equal(back["t_ns"], t_ns)
    np.testing.assert_array_equal(back["x_m"], x_m)
    np.testing.assert_array_equal(back["y_m"], x_m[::-1])
    assert back["source"].tolist() == source.tolist()


def test_the_file_depends_on_the_rows_alone(tmp_path: Path) -> None:
    columns = poses(40_000)
    write_table(tmp_path / "whole", TABLES["poses"], columns)
    with TableWriter(tmp_path / "batches", TABLES["poses"]) as table:
        for first in range(0, 40_000, 777):
            table.append(cut(columns, first, min(first + 777, 40_000)))
    with TableWriter(tmp_path / "rows", TABLES["poses"]) as table:
        table.append(cut(columns, 0, 10_000))
        for i in range(10_000, 40_000):
            table.add_row({name: values[i] for name, values in columns.items()})
    whole = (tmp_path / "whole").read_bytes()
    assert (tmp_path / "batches").read_bytes() == whole
    assert (tmp_path / "rows").read_bytes() == whole
    assert pq.ParquetFile(tmp_path / "whole").metadata.num_row_groups == 3


def test_columns_are_checked_by_name(tmp_path: Path) -> None:
    good = poses(3)
    for change, error, match in [
        ({"t_ns": np.array([1.0, 2.0, 3.0])}, TypeError, "t_ns: float64"),
        ({"t_ns": np.array([1, 2, 2**63], np.uint64)}, TypeError, "t_ns: uint64"),
        ({"x_m": np.zeros(2)}, ValueError, "one length"),
        ({"x_m": np.zeros((3, 2))}, ValueError, "one-dimensional"),
        ({"x": 0.0}, ValueError, r"unknown: \['x'\]"),
        ({"source": 3}, TypeError, "source: int64"),
    ]:
        with pytest.raises(error, match=match):
            write_table(tmp_path / "poses.parquet", TABLES["poses"], {**good, **change})
    del good["y_m"]
    with pytest.raises(ValueError, match=r"missing: \['y_m'\]"):
        write_table(tmp_path / "poses.parquet", TABLES["poses"], good)
    writer = TableWriter(tmp_path / "poses.parquet", TABLES["poses"])
    rows = [{name: values[0] for name, values in of.items()} for of in (poses(3), good)]
    with pytest.raises(ValueError, match=r"missing: \['y_m'\]"), writer as table:
        list(map(table.add_row, rows))
    assert [each.name for each in tmp_path.iterdir()] == []


def test_columns_that_a_summary_of_before_lacks_are_without_values(tmp_path: Path) -> None:
    lacked = (*COST_NAMES, "worker", "duty_factor")
    before = pa.schema([each for each in TABLES["summary"] if each.name not in lacked])
    rows = {"recording": ["a", "b"], "exit_code": [0, 1], "reason": ["", "x"]}
    write_table(tmp_path / "summary.parquet", before, rows)
    back = read_table(tmp_path, "summary")
    assert list(back) == TABLES["summary"].names
    assert back["worker"].tolist() == ["", ""]
    assert all(np.isnan(back[name]).all() and len(back[name]) == 2 for name in ("eta_m", *COST_NAMES, "duty_factor"))


POSE = {"t_ns": [1], "x_m": [1.0], "y_m": [1.0], "yaw_rad": [1.0], "source": ["a"]}


@pytest.mark.parametrize(
    ("columns", "match"),
    [
        ({"t_ns": [1.5], "x": [1]}, "has no column t_ns of type int64"),
        (POSE | {"t_ns": pa.array([None], pa.int64())}, "t_ns has missing values"),
        (POSE | {"source": pa.array([b"\xff\xfe"]).view(pa.string())}, r"poses\.parquet: is damaged"),
        ({key: of for key, of in POSE.items() if key != "source"}, "has no column source"),
    ],
)
def test_foreign_tables_are_refused(tmp_path: Path, columns: Any, match: str) -> None:
    pq.write_table(pa.table(columns), tmp_path / "poses.parquet")
    with pytest.raises(NotARun, match=match):
        read_table(tmp_path, "poses")


def test_a_table_that_would_fill_the_memory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_table(tmp_path / "poses.parquet", TABLES["poses"], poses(100))
    monkeypatch.setattr(tables, "_MAX_VALUES", 799)
    with pytest.raises(TooLarge, match="800"):
        read_table(tmp_path, "poses")
