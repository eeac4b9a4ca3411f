from __future__ import annotations

from pathlib import Path

from quadlog.results.plots.run_data import RunData
from quadlog.results.run.tables import TABLES, start_ns, write_table


def test_a_run_starts_where_its_figures_do(tiny_run: Path, tmp_path: Path) -> None:
    assert start_ns(tiny_run) == RunData(tiny_run).start_ns > 0
    assert start_ns(tmp_path / "none") == 0


def test_the_first_of_all_tables_counts(tmp_path: Path) -> None:
    columns = {"x_m": 0.0, "y_m": 0.0, "source": "uwb"}
    write_table(tmp_path / "target.parquet", TABLES["target"], columns | {"t_ns": [7, 9]})
    write_table(tmp_path / "poses.parquet", TABLES["poses"], columns | {"t_ns": [3, 5], "yaw_rad": 0.0})
    assert start_ns(tmp_path) == 3
