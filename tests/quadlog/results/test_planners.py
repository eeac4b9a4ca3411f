"""The formats themselves are tested in results/test_text.py."""

from __future__ import annotations

import csv
import io
import json
from typing import Any

import pyarrow as pa
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import csv_cell
from quadlog.results.planners import PLANNERS, format_rows

INTEGERS = {field.name for field in PLANNERS if field.type == pa.int64()}


def row(**columns: Any) -> dict[str, Any]:
    plain: dict[str, Any] = {name: 40 if name in INTEGERS else 0.5 for name in PLANNERS.names}
    plain |= {"source": "forest:0.2", "planner": "astar", "replans": 6800, "success_rate": 0.985, "us_median": 27.34}
    plain |= {"expanded_mean": 198.87, "ratio_expanded": 1.0, "ratio_low": 1.0, "ratio_high": 1.0}
    plain |= {"suboptimality_mean": 0.0, "us_p95": 67.5, "fallback_share": None}
    return plain | columns


ROWS = [
    row(),
    row(planner="ia_star", ratio_expanded=4.961, ratio_low=4.79, ratio_high=5.159, fallback_share=0.0457),
    row(source="runs/x", episodes=1, replans=12, ratio_low=None, ratio_high=float("nan")),
]
TABLE = """\
forest:0.2: 40 episodes, 6800 replans
planner  found %  cells  ratio  95 %          excess %  time us  p95 us
astar       98.5  198.9      1  1 to 1               0    27.34    67.5
ia_star     98.5  198.9  4.961  4.79 to 5.16         0    27.34    67.5

runs/x: 1 episode, 12 replans
planner  found %  cells  ratio  95 %  excess %  time us  p95 us
astar       98.5  198.9      1               0    27.34    67.5
"""


def test_readers_get_a_table_of_each_source_with_its_key_and_notes() -> None:
    text = format_rows(ROWS, "plain", ["how it was paired"])
    tables, _, notes = text.rpartition("\n\n")
    assert [line.split() for line in tables.splitlines()] == [line.split() for line in TABLE.splitlines()]
    assert notes.startswith("cells: expanded per replan")
    assert notes.endswith("\nhow it was paired\n")


texts = st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), max_size=12)
numbers = st.none() | st.floats(allow_nan=False, allow_infinity=False)


@given(st.lists(st.tuples(texts, numbers, numbers, st.integers(0, 2**62)), max_size=4))
def test_csv_and_json_come_back_exactly(given_rows: list[tuple[str, float | None, float | None, int]]) -> None:
    names = ("source", "ratio_low", "turn_rad_total", "touched_total")
    rows = [row(**dict(zip(names, each, strict=True))) for each in given_rows]
    read = list(csv.DictReader(io.StringIO(format_rows(rows, "csv"), newline="")))
    for got, wanted in zip(read, rows, strict=True):
        shown = {name: "" if wanted[name] is None else str(wanted[name]) for name in names}
        assert {name: got[name] for name in names} == shown | {"source": csv_cell(wanted["source"])}
    existing = [{name: value for name, value in each.items() if value is not None} for each in rows]
    assert json.loads(format_rows(rows, "json")) == existing
