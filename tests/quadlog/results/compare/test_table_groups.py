from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from quadlog.errors import NotARun, TooLarge
from quadlog.results.compare import table_diff as table_groups
from quadlog.results.compare.differences import Tolerance
from quadlog.results.compare.file_diff import compare_files
from quadlog.results.compare.table_diff import open_table
from quadlog.results.run.tables import TABLES, read_table, write_table


def test_groups_together_are_the_table(tiny_run: Path) -> None:
    with open_table(tiny_run, "control") as control:
        names = TABLES["control"].names
        pieces = [control.read(names, i, i + 1) for i in range(control.groups)]
        assert control.rows == 200
    for name, values in read_table(tiny_run, "control").items():
        np.testing.assert_array_equal(np.concatenate([piece[name] for piece in pieces]), values)


def test_a_cut_file_is_named(tiny_run: Path) -> None:
    path = tiny_run / "control.parquet"
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(NotARun, match=r"control\.parquet: is damaged"), open_table(tiny_run, "control"):
        pass


def test_a_flipped_bit_is_found_by_its_checksum(tiny_run: Path) -> None:
    path = tiny_run / "poses.parquet"
    content = bytearray(path.read_bytes())
    content[200] ^= 1
    path.write_bytes(content)
    with pytest.raises(NotARun, match=r"poses\.parquet: is damaged"):
        compare_files("poses.parquet", tiny_run, tiny_run, Tolerance())


@pytest.mark.parametrize("schema", [{"t_ns": pa.float64()}, {"x_m": pa.float64()}])
def test_a_table_of_other_columns_is_no_table_of_a_run(tmp_path: Path, schema: dict[str, pa.DataType]) -> None:
    pq.write_table(pa.table({name: pa.array([], kind) for name, kind in schema.items()}), tmp_path / "poses.parquet")
    with pytest.raises(NotARun, match="has no column t_ns of type int64"), open_table(tmp_path, "poses"):
        pass


def test_rows_beyond_memory_are_refused_before_they_are_read(tiny_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_groups, "MAX_ROWS_AT_ONCE", 199)
    with open_table(tiny_run, "control") as control, pytest.raises(TooLarge, match="200"):
        control.read(["t_ns"], 0, control.groups)


def test_memory_does_not_grow_with_the_table(tmp_path: Path) -> None:
    """Arrow's own memory and numpy's, while tables of three and of thirty row groups are compared."""
    peaks = []
    for groups in (3, 30):  # from the second on, one group is read while the one before it is still held
        run = tmp_path / str(groups)
        run.mkdir()
        n = groups * 16384
        x_m = np.random.default_rng(0).normal(size=n)
        columns = {"t_ns": np.arange(n), "x_m": x_m, "y_m": x_m, "yaw_rad": x_m, "source": "uwb"}
        write_table(run / "poses.parquet", TABLES["poses"], columns)
        pool = pa.proxy_memory_pool(pa.default_memory_pool())
        before = pa.default_memory_pool()
        pa.set_memory_pool(pool)
        tracemalloc.start()
        assert compare_files("poses.parquet", run, run, Tolerance()).same
        peaks.append(tracemalloc.get_traced_memory()[1] + pool.max_memory())
        tracemalloc.stop()
        pa.set_memory_pool(before)
    assert peaks[1] < 1.1 * peaks[0]
