"""`quadlog diff`: equal runs, what differs and where first, tolerances, damage, remote runs."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pandas as pd
import pytest

from quadlog.results.diff import MADE, merge_frames
from quadlog.results.tables import read_table
from tests.lab.runs import change, change_json


@pytest.fixture
def copy(follow, tmp_path):
    return shutil.copytree(follow, tmp_path / "follow")


def listed(quadlog, *arguments):
    done = quadlog("diff", *arguments, "--json")
    rows = json.loads(done.out)
    assert done.code == (4 if any(row["stage"] != MADE for row in rows) else 0)
    return rows


def test_another_seed_alone_is_listed_and_is_no_difference(follow, copy, quadlog):
    change_json(copy / "run.json", seed=3)
    done = quadlog("diff", follow, copy)
    assert (done.code, done.err) == (0, "")
    assert done.out.splitlines()[2:] == ["results: the same", "", "made with  A  B", "seed       0  3"]
    (row,) = listed(quadlog, follow, copy)
    assert row == {"stage": MADE, "result": "run.json", "column": "seed", "rows": 1, "a": 0, "b": 3}
    assert listed(quadlog, follow, follow) == []
    change_json(copy / "run.json", topics=[])
    assert quadlog("diff", copy, follow).code == 4


def test_one_column_of_one_row(follow, copy, quadlog):
    poses = read_table(follow, "poses")
    change(copy, "poses", x_m=lambda x_m: x_m + 0.25 * (np.arange(len(x_m)) == 3))
    (row,) = listed(quadlog, follow, copy)
    assert (row["stage"], row["result"], row["column"], row["rows"]) == ("position", "poses", "x_m", 1)
    assert (row["t_ns"], row["a"], row["apart"]) == (poses["t_ns"][3], poses["x_m"][3], pytest.approx(0.25))
    first = quadlog("diff", follow, copy).out.splitlines()[2]
    assert first.startswith("results: differ, first in stage position: poses, x_m at ")
    assert first.endswith(" (by 0.25)")
    change(copy, "poses", y_m=lambda y_m: y_m + 0.25, yaw_rad=lambda yaw_rad: yaw_rad + 0.25)
    change(copy, "fixes", x_m=lambda x_m: x_m + 1)
    _, _, head, *rows = quadlog("diff", follow, copy).out.splitlines()[2:]
    assert max(map(len, rows)) <= 80
    assert [row.split("  ")[0] for row in (head, *rows)][-5:] == [
        "position:", "fixes, x_m", *(f"poses, {name}" for name in ("y_m", "yaw_rad", "x_m"))]  # fmt: skip


def test_a_result_that_only_one_run_has_comes_first_and_a_damaged_one_is_an_error(follow, copy, quadlog, refused):
    change(copy, "fixes", x_m=lambda x_m: x_m + 1)
    (copy / "poses.parquet").unlink()
    rows = listed(quadlog, follow, copy)
    assert (rows[0]["result"], rows[0]["a"], rows[0]["b"]) == ("poses.parquet", "saved", "missing")
    assert [row["result"] for row in rows[1:]] == ["fixes"]
    (copy / "scans.parquet").write_bytes(b"PAR1")
    assert "scans.parquet" in refused(1, "diff", copy, follow, "--json")


@pytest.mark.parametrize(
    ("a", "b", "tolerances", "differs"),
    [
        ([1.0, np.nan], [1.0, np.nan], {}, False),
        ([np.inf], [np.inf], {}, False),
        ([np.inf], [1.0], {"absolute": 1e9, "relative": 0.5}, True),
        ([1.0], [1.0 + 1e-6], {"absolute": 2e-6}, False),
        (np.int64([2**62]), np.int64([2**62 + 1]), {}, True),
        ([True], [False], {"absolute": 9.0}, True),
    ],
)
def test_values_are_equal_within_the_tolerance(a, b, tolerances, differs):
    frames = [pd.DataFrame({"t_ns": np.arange(len(values)), "x": values}) for values in (a, b)]
    assert bool(list(merge_frames("x", *frames, **tolerances))) is differs


def test_rows_are_matched_by_tag_and_angles_by_the_shorter_way():
    both = pd.DataFrame({"t_ns": 0, "tag": [0, 1], "nis": [0.5, 2.0]})
    (row,) = merge_frames("innovations", both, both[1:])
    assert (row["result"], row["column"], row["rows"]) == ("innovations", "rows only in A", 1)
    frames = [pd.DataFrame({"t_ns": [0], "yaw_rad": [yaw]}) for yaw in (np.pi - 0.01, 0.01 - np.pi)]
    (row,) = merge_frames("poses", *frames)
    assert row["apart"] == pytest.approx(0.02)


def test_tolerances_of_the_command(follow, copy, quadlog, refused):
    change_json(copy / "metrics.json", uwb_residual_m__value=0.5)
    other = shutil.copytree(copy, copy.with_name("b"))
    change_json(other / "metrics.json", uwb_residual_m__value=0.500001)
    allowed = ([], ["--tolerance", "2e-6"], ["--relative", "1e-4"])
    assert [quadlog("diff", copy, other, *each).code for each in allowed] == [4, 0, 0]
    for wrong in ("-1", "nan", "inf"):
        refused(2, "diff", follow, follow, "--tolerance", wrong)


def test_of_a_remote_run_only_what_is_compared_is_asked_for(follow, web, quadlog):
    shutil.copytree(follow, web.folder / "follow")
    done = quadlog("diff", follow, f"{web.url}/follow")
    assert (done.code, done.err) == (0, "")
    asked = {path.rpartition("/")[2] for _, path, _ in web.requests}
    assert {"run.json", "fixes.parquet", "maps.npz"} <= asked
    assert asked.isdisjoint({"derived.mcap", "report.html", "foxglove-layout.json", "config.toml"})
