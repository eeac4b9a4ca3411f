"""Recordings of which only the summary of their folder tells."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from quadlog.results.run.find_runs import RECORDS, failed_recordings, runs_here
from quadlog.results.run.tables import TABLES, write_table
from quadlog.storage.remote_path import to_path


def write_summary(folder: Path, codes: Mapping[str, int]) -> None:
    columns: dict[str, Any] = dict.fromkeys(TABLES["summary"].names, np.nan)
    columns |= {"recording": list(codes), "exit_code": list(codes.values()), "reason": "no bag", "worker": ""}
    write_table(folder / "summary.parquet", TABLES["summary"], columns)


def test_those_without_a_run_are_told_with_their_reason(tiny_run: Path, tmp_path: Path) -> None:
    season = tmp_path / "season"
    shutil.copytree(tiny_run, season / "walk")
    write_summary(season, {"walk": 1, "broken": 1, "lossy": 3, "fine": 0, "../outside": 1})
    assert failed_recordings([season]) == {season / "broken": f"{season / 'broken'}: was not replayed: no bag"}
    assert failed_recordings([season / "walk"]) == {}  # its last replay failed, and harmed no earlier run
    (season / "summary.parquet").write_bytes(b"mine")
    assert failed_recordings([season, tmp_path]) == {}


def test_they_are_told_of_a_bucket_too(tiny_run: Path, tmp_path: Path, bucket: Any) -> None:
    write_summary(tmp_path, {"walk": 0, "broken": 1})
    bucket.put_file(str(tmp_path / "summary.parquet"), f"{bucket.name}/season/summary.parquet")
    for name in ("run.json", "config.toml", "metrics.json"):
        bucket.put_file(str(tiny_run / name), f"{bucket.name}/season/walk/{name}")
    with runs_here([to_path(f"s3://{bucket.name}/season")], RECORDS) as here:
        (failed,) = failed_recordings(here)
        assert here.as_given(failed) == f"s3://{bucket.name}/season/broken"
