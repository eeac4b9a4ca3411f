from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import TooLarge
from quadlog.results.compare import table_diff
from quadlog.results.compare.differences import ResultDifference, Tolerance
from quadlog.results.compare.file_diff import KEYS, compare_files
from quadlog.results.compare.table_diff import match_rows
from quadlog.results.run.tables import TABLES, write_table

EXACT = Tolerance()
FIXES = [name for name in TABLES["fixes"].names if name not in KEYS["fixes"]]


def fixes(n: int, tag_first: bool = False) -> dict[str, Any]:
    """n epochs of two tags, in order of time or of tag."""
    rng = np.random.default_rng(n)
    t_ns, tag = np.repeat(np.arange(n) * 10 + 1000, 2), np.tile([0, 1], n)
    columns: dict[str, Any] = {name: rng.normal(size=2 * n) for name in FIXES}
    columns |= {"t_ns": t_ns, "tag": tag, "n_ranges": rng.integers(3, 9, 2 * n), "outlier": rng.random(2 * n) < 0.5}
    order = np.argsort(tag, kind="stable") if tag_first else np.arange(2 * n)
    return {name: values[order] for name, values in columns.items()}


def compare(folder: Path, a: dict[str, Any], b: dict[str, Any], tolerance: Tolerance = EXACT) -> ResultDifference:
    for name, columns in (("a", a), ("b", b)):
        (folder / name).mkdir(exist_ok=True)
        write_table(folder / name / "fixes.parquet", TABLES["fixes"], columns)
    return compare_files("fixes.parquet", folder / "a", folder / "b", tolerance)


def without(columns: dict[str, Any], rows: Any) -> dict[str, Any]:
    return {name: np.delete(values, rows) for name, values in columns.items()}


@given(data=st.data())
def test_what_was_changed_is_what_is_found(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Values moved at random rows of random columns, rows taken out at random: exactly that, by brute force."""
    n = data.draw(st.integers(1, 40))
    a = fixes(n, tag_first=data.draw(st.booleans()))
    b = {name: values.copy() for name, values in a.items()}
    cells = st.tuples(st.sampled_from(["x_m", "n_ranges", "outlier"]), st.integers(0, 2 * n - 1))
    moved = data.draw(st.dictionaries(cells, st.floats(1, 9), max_size=12))
    for (column, row), by in moved.items():
        b[column][row] = not b[column][row] if column == "outlier" else b[column][row] + round(by)
    lost_a, lost_b = (data.draw(st.sets(st.integers(0, 2 * n - 1), max_size=5)) for _ in "ab")
    found = compare(
        tmp_path_factory.mktemp("runs"), without(a, sorted(lost_a)), without(b, sorted(lost_b)), Tolerance(1e-12)
    )

    assert (found.rows_a, found.rows_b) == (2 * n - len(lost_a), 2 * n - len(lost_b))
    for only, rows in ((found.only_in_a, lost_b - lost_a), (found.only_in_b, lost_a - lost_b)):
        assert (only.rows if only else 0) == len(rows)
        if only:
            assert only.first.t_ns == min(a["t_ns"][row] for row in rows)
    compared = {key: by for key, by in moved.items() if key[1] not in lost_a | lost_b}
    assert [each.column for each in found.columns] == [name for name in FIXES if name in {key[0] for key in compared}]
    for each in found.columns:
        changed = [row for column, row in compared if column == each.column]
        first = min(changed, key=lambda row: (a["t_ns"][row], row))
        assert each.rows == len(changed)
        assert (each.first.t_ns, each.first.keys) == (a["t_ns"][first], (("tag", a["tag"][first]),))
        assert (each.a, each.b) == (a[each.column][first], b[each.column][first])
        if each.column != "outlier":
            assert each.apart == pytest.approx(round(compared[each.column, first]))
            assert each.largest == pytest.approx(max(round(compared[each.column, row]) for row in changed))


def test_the_same_rows_in_another_order_are_the_same(tmp_path: Path) -> None:
    assert compare(tmp_path, fixes(50), fixes(50, tag_first=True)).same


def test_no_value_is_the_same_as_no_value_and_differs_from_one(tmp_path: Path) -> None:
    a, b = fixes(5), fixes(5)
    for columns in (a, b):
        columns["x_m"][2] = columns["y_m"][3] = np.nan
    assert compare(tmp_path, a, b).same
    b["x_m"][2] = 7.0
    (column,) = compare(tmp_path, a, b).columns
    assert (column.a, column.b, column.apart, column.largest, column.rows) == (None, 7.0, None, None, 1)


def test_angles_are_neighbours_across_the_turn(tmp_path: Path) -> None:
    for name, yaw_rad in (("a", np.pi - 1e-9), ("b", -np.pi + 1e-9)):
        (tmp_path / name).mkdir()
        columns = {"t_ns": np.arange(3), "x_m": 0.0, "y_m": 0.0, "yaw_rad": yaw_rad, "source": "uwb"}
        columns |= {"z_m": np.nan, "roll_rad": np.nan, "pitch_rad": np.nan}
        write_table(tmp_path / name / "poses.parquet", TABLES["poses"], columns)
    assert compare_files("poses.parquet", tmp_path / "a", tmp_path / "b", Tolerance(1e-6)).same
    (column,) = compare_files("poses.parquet", tmp_path / "a", tmp_path / "b", EXACT).columns
    assert column.largest == pytest.approx(2e-9, rel=1e-3)


def test_the_first_in_time_is_not_the_first_in_the_file(tmp_path: Path) -> None:
    a, b = fixes(40, tag_first=True), fixes(40, tag_first=True)
    for row in (30, 5, 42):  # of tag 0 the epochs 30 and 5, of tag 1, in a later group, epoch 2
        b["x_m"][row] += row
    (column,) = compare(tmp_path, a, b).columns
    assert (column.first.t_ns, column.first.keys) == (1020, (("tag", 1),))
    assert (column.apart, column.largest) == (pytest.approx(42), pytest.approx(42))
    b["x_m"][42] = a["x_m"][42]
    (column,) = compare(tmp_path, a, without(b, [0])).columns
    assert (column.first.t_ns, column.rows) == (1050, 2)


def test_an_empty_table_is_compared_too(tmp_path: Path) -> None:
    empty = without(fixes(1), [0, 1])
    assert compare(tmp_path, empty, empty).same
    only = compare(tmp_path, empty, fixes(20)).only_in_b
    assert (only.rows, only.first.t_ns) == (40, 1000)


def test_the_start_is_the_first_instant_in_either(tmp_path: Path) -> None:
    assert compare(tmp_path, without(fixes(9), [0, 1]), fixes(9)).start_ns == 1000
    assert compare(tmp_path, without(fixes(9), []), without(fixes(9), [0, 1, 2, 3])).start_ns == 1000


def test_durations_are_not_compared(tmp_path: Path) -> None:
    scans: dict[str, Any] = {name: np.arange(3) for name in TABLES["scans"].names}
    scans["ground_found"] = np.ones(3, np.bool_)
    for name, ms in (("a", 1.0), ("b", 2.0)):
        (tmp_path / name).mkdir()
        write_table(tmp_path / name / "scans.parquet", TABLES["scans"], scans | {"ms": np.full(3, ms)})
    assert compare_files("scans.parquet", tmp_path / "a", tmp_path / "b", EXACT).same


ROWS = st.lists(st.tuples(st.integers(-3, 3), st.integers(0, 2), st.sampled_from(["fixes", "track"])), max_size=30)


def columns(rows: list[tuple[int, int, str]]) -> dict[str, Any]:
    kinds = {"t_ns": np.int64, "tag": np.int64, "source": object}
    return {name: np.array([row[k] for row in rows], kind) for k, (name, kind) in enumerate(kinds.items())}


@given(ROWS, ROWS)
def test_of_rows_with_one_key_the_first_belongs_to_the_first(a: list[Any], b: list[Any]) -> None:
    match = match_rows("x", columns(a), columns(b))
    left = list(enumerate(b))
    wanted, only_a = [], []
    for i, key in enumerate(a):
        found = next((each for each in left if each[1] == key), None)
        if found is None:
            only_a.append(i)
        else:
            left.remove(found)
            wanted.append((i, found[0]))
    assert list(zip(match.a.tolist(), match.b.tolist(), strict=True)) == wanted
    assert match.only_a.tolist() == only_a
    assert match.only_b.tolist() == [k for k, _ in left]


def test_wide_keys_do_not_overflow() -> None:
    wide = np.array([-(2**63), 2**63 - 1, 0], np.int64)
    assert match_rows("x", {"a": wide, "b": wide}, {"a": wide[::-1], "b": wide[::-1]}).b.tolist() == [2, 1, 0]


def test_too_many_rows_are_not_matched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_diff, "MAX_ROWS_AT_ONCE", 2)
    rows = np.arange(3)
    assert match_rows("x", {"t_ns": rows}, {"t_ns": rows}).a.tolist() == [0, 1, 2]
    with pytest.raises(TooLarge, match="x: rows to compare at once: 3"):
        match_rows("x", {"t_ns": rows}, {"t_ns": rows[:2]})
