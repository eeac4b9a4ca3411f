from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from quadlog.errors import UnknownName, csv_cell
from quadlog.results.planner_comparison.tables import FORMATS, PLANNERS, format_rows, write_planners

INTEGERS = {field.name for field in PLANNERS if field.type == pa.int64()}


def test_rows_come_back_and_what_does_not_exist_is_null(tmp_path: Path) -> None:
    texts = {"source": "forest:0.2", "planner": "astar"}
    row = {name: texts.get(name, 3 if name in INTEGERS else 0.5) for name in PLANNERS.names}
    rows = [row | {"fallback_share": None}, row | {"planner": "ia_star", "ratio_low": None, "fallback_share": None}]
    write_planners(tmp_path / "planners.parquet", rows)
    assert pq.read_table(tmp_path / "planners.parquet").to_pylist() == rows


NAN = float("nan")


def row(**columns: Any) -> dict[str, Any]:
    plain: dict[str, Any] = {"source": "forest:0.2", "planner": "astar", "episodes": 40, "replans": 6800}
    plain |= {"success_rate": 0.985, "expanded_total": 1352345, "generated_total": 20271, "touched_total": 9999}
    plain |= {"expanded_mean": 198.87, "ratio_expanded": 1.0, "ratio_low": 1.0, "ratio_high": 1.0}
    plain |= {"suboptimality_mean": 0.0, "suboptimality_p95": 0.1134, "fallback_share": None}
    plain |= {"us_median": 27.34, "us_p95": 67.5, "length_m_total": 20764.4, "turn_rad_total": 1.5}
    assert list(plain) == PLANNERS.names
    return plain | columns


ROWS = [
    row(),
    row(planner="ia_star", ratio_expanded=4.961, ratio_low=4.79, ratio_high=5.159, fallback_share=0.0457),
    row(source="runs/x", episodes=1, replans=12, ratio_low=None, ratio_high=NAN),
]


TABLE = """\
forest:0.2: 40 episodes, 6800 replans
         share %         cells in all                 ratio              excess %   time us      paths in all
planner  solved scratch  expand gener. touch /replan  median       95 %  mean  p95  median  p95      m  rad
astar      98.5          1.352M 20.27k  9999     199    1.00 1.00..1.00  0.00 11.3    27.3 67.5  20764 1.50
ia_star    98.5    4.57  1.352M 20.27k  9999     199    4.96 4.79..5.16  0.00 11.3    27.3 67.5  20764 1.50

runs/x: 1 episode, 12 replans
         share %         cells in all                 ratio        excess %   time us      paths in all
planner  solved scratch  expand gener. touch /replan  median 95 %  mean  p95  median  p95      m  rad
astar      98.5          1.352M 20.27k  9999     199    1.00       0.00 11.3    27.3 67.5  20764 1.50

one note
another
"""


def test_the_formats_are_the_contracts() -> None:
    assert list(FORMATS) == ["table", "json", "csv", "markdown", "latex"]
    with pytest.raises(UnknownName, match="csv, json, latex, markdown, table"):
        format_rows(ROWS, "yaml")


def test_the_table_is_aligned_and_fits_a_terminal() -> None:
    assert format_rows(ROWS, "table", ["one note", "another"]) == TABLE
    largest = row(planner="ia_star_bounded", fallback_share=1.0, touched_total=10**9, ratio_low=0.166, ratio_high=0.166)
    assert max(map(len, format_rows([largest], "table").splitlines())) <= 120


def test_json_is_a_list_of_flat_objects_without_what_does_not_exist() -> None:
    read = json.loads(format_rows(ROWS, "json", ["left out"]))
    assert read[1] == ROWS[1]
    assert list(read[1]) == PLANNERS.names
    assert "fallback_share" not in read[0]
    assert {"ratio_low", "ratio_high"} & set(read[2]) == set()
    assert json.loads(format_rows([], "json")) == []


texts = st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), max_size=12)
numbers = st.none() | st.floats(allow_nan=False, allow_infinity=False)


@given(st.lists(st.tuples(texts, numbers, numbers, st.integers(0, 2**62)), max_size=4))
def test_csv_and_json_come_back_exactly(given_rows: list[tuple[str, float | None, float | None, int]]) -> None:
    names = ("source", "ratio_low", "turn_rad_total", "touched_total")
    rows = [row(**dict(zip(names, each, strict=True))) for each in given_rows]
    read = list(csv.DictReader(io.StringIO(format_rows(rows, "csv", ["left out"]), newline="")))
    assert len(read) == len(rows)
    for got, wanted in zip(read, rows, strict=True):
        assert list(got) == PLANNERS.names
        assert got["source"] == csv_cell(wanted["source"])
        for name in ("ratio_low", "turn_rad_total"):
            assert got[name] == ("" if wanted[name] is None else repr(wanted[name]))
        assert int(got["touched_total"]) == wanted["touched_total"]
    existing = [{name: value for name, value in each.items() if value is not None} for each in rows]
    assert json.loads(format_rows(rows, "json")) == existing


hostile = st.text('abc|&%$#_{}~^\\<>`*"[]\n\t\x1b;=', min_size=1, max_size=20) | st.just("\\input{/etc/passwd}\n|")


@given(hostile)
def test_names_keep_no_meaning_that_was_not_meant(name: str) -> None:
    rows = [row(source=name, planner=name)]
    tokens = MarkdownIt("commonmark").enable("table").parse(format_rows(rows, "markdown", [name]))
    assert {token.type for token in tokens} <= {
        *("paragraph_open", "inline", "paragraph_close"),
        *(f"{part}_{end}" for part in ("table", "thead", "tbody", "tr", "th", "td") for end in ("open", "close")),
    }
    assert all({child.type for child in token.children or []} <= {"text"} for token in tokens)
    assert sum(token.type == "td_open" for token in tokens) == 15
    latex = format_rows(rows, "latex", [name])
    lines = latex.splitlines()
    assert [line for line in lines if line.startswith("%")] == lines[:2]
    caption = next(line for line in lines if line.startswith("\\caption"))
    plain = re.sub(r"\\[&%$#_{}]|\\text[a-z]+\{\}", "", caption.removeprefix("\\caption{").removesuffix("}"))
    assert not re.search(r"[&%$#_{}~^\\<>|`\"]", plain)
    table = format_rows(rows, "table", [name])
    assert "\x1b" not in latex + table
    assert len(table.splitlines()) == 6


def test_latex_has_two_floating_tables_for_each_source() -> None:
    latex = format_rows(ROWS, "latex", ["how it was paired"])
    assert latex.startswith("% needs \\usepackage{booktabs,graphicx}\n% how it was paired\n\\begin{table}")
    assert re.findall(r"\\begin\{tabular\}\{@\{\}(l+r+)@\{\}\}", latex) == ["lrrrrrrrr", "lrrrrrr"] * 2
    parts = ("search", "paths")
    assert re.findall(r"\\label\{(.*)\}", latex) == [f"tab:planners-{n}-{part}" for n in (1, 2) for part in parts]
    assert "\nia\\_star & 98.5 & 4.57 & 1.352M & 20.27k & 9999 & 199 & 4.96 & 4.79..5.16 \\\\\n" in latex


def test_a_name_that_is_no_text_stops_no_format() -> None:
    for each in FORMATS:
        assert format_rows([row(source="half \ud800")], each, ["half \ud800"]).encode()


@pytest.mark.parametrize(
    ("cells", "shown"),
    [(0, "0"), (9999, "9999"), (10_000, "10.00k"), (999_999, "1000k"), (10**6, "1.000M"), (5 * 10**15, "5000T")],
)
def test_totals_are_short(cells: int, shown: str) -> None:
    line = format_rows([row(expanded_total=cells)], "csv").splitlines()[1]
    assert line.split(",")[5] == str(cells)
    assert f" {shown} " in format_rows([row(expanded_total=cells)], "table").splitlines()[3]
