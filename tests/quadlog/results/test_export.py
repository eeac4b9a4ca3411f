from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from quadlog.errors import NotARun
from quadlog.results.export import export_run
from quadlog.results.tables import TABLES, read_table, write_table
from tests.lab.runs import until_ingest


def test_csv_keeps_every_digit_and_names_are_no_formulas(tiny_run: Path, tmp_path: Path) -> None:
    poses = read_table(tiny_run, "poses")
    poses["source"][:] = '=HYPERLINK("http://x")'
    write_table(tiny_run / "poses.parquet", TABLES["poses"], poses)
    written = export_run(tiny_run, "csv", tmp_path / "csv")
    assert {path.stem for path in written} == {path.stem for path in tiny_run.glob("*.parquet")}
    for name in ("poses", "plans", "control", "fixes"):
        csv, parquet = pd.read_csv(tmp_path / "csv" / f"{name}.csv"), pd.read_parquet(tiny_run / f"{name}.parquet")
        assert list(csv) == TABLES[name].names
        if name == "poses":
            assert set(csv.pop("source")) == {'\'=HYPERLINK("http://x")'}
            parquet.pop("source")
        pd.testing.assert_frame_equal(csv, parquet, check_dtype=False, check_exact=True)
    assert b"\r" not in (tmp_path / "csv" / "poses.csv").read_bytes()


@pytest.mark.parametrize("to", ["tum", "csv", "rosmap", "mcap", "gif"])
def test_a_run_without_the_result_says_so(tiny_run: Path, tmp_path: Path, to: str) -> None:
    (tiny_run / "map.pgm").unlink()
    until_ingest(tiny_run)
    with pytest.raises(NotARun, match="has no"):
        export_run(tiny_run, to, tmp_path / "out")
    assert not (tmp_path / "out").exists()
