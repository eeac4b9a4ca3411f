"""Every table in every format, whatever its cells hold."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from quadlog.cli import options
from quadlog.errors import csv_cell
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.metrics.summary import MeasuredRun, Metric
from quadlog.results.studies.planners import PLANNERS, format_rows
from quadlog.results.text import FORMATS, interval_text, metrics_text, print_table, value_text, values_text

NASTY = "a|b_$x#\x1b[31m\nc & 100% ~^{}<script>`*\\"
HEADER = ("name", "value", "n")
ROWS = [("a_b", 0.123456789, 1234567), ("[x]", None, 0), (NASTY, -1.5, -3), ("late", float("nan"), 2)]
DETAIL = {"mean": 0.25, "std": 0.125, "p50": 0.2, "p95": 0.5}


def runs(*labels: str) -> list[MeasuredRun]:
    metrics = {
        "eta_m": Metric(0.1 + 0.2, 600, "m", (0.2, 0.3), detail=DETAIL),
        "expanded_total": Metric(5931.0, 120, ""),
    }
    return [MeasuredRun(Path("runs") / label, label, metrics) for label in labels]


def planners(source: str, planner: str) -> list[dict[str, Any]]:
    row: dict[str, Any] = dict.fromkeys(PLANNERS.names, 1.5)
    row |= {"source": source, "planner": planner, "episodes": 1, "replans": 12, "fallback_share": None}
    return [row | {"ratio_low": None, "ratio_high": None, "us_p95": 0.1 + 0.2}]


def printed(kind: str, to: str, name: str) -> str:
    return metrics_text(runs(name), to) if kind == "metrics" else format_rows(planners(name, name), to, [name])


def cells_of(markdown: str) -> list[str]:
    """What a reader sees in cells; anything but plain text would be markup that slipped through."""
    tokens = MarkdownIt("commonmark").enable("table").parse(markdown)
    inline = [token for token in tokens if token.type == "inline"]
    assert {child.type for token in inline for child in token.children or []} <= {"text"}
    assert {token.type.split("_")[0] for token in tokens} <= {
        *["table", "thead", "tbody", "tr", "th", "td", "inline", "paragraph"]
    }
    return ["".join(child.content for child in token.children or []) for token in inline]


def read(text: str, beside: str) -> float:
    """What a reader takes a number for that stands beside a value with its unit, in the unit of the saved one."""
    amount = float(re.match(r"[-\u2212+]?[\d.e+-]+", text)[0].replace("\u2212", "-"))  # type: ignore[index]
    return amount / 100 if "%" in beside else float(np.radians(amount)) if "\u00b0" in beside else amount


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_value_and_interval_read_back_in_one_unit_are_the_saved_ones(one: float, other: float) -> None:
    ends = min(one, other), max(one, other)
    for name, entry in CATALOGUE.items():
        value, interval = value_text(name, one, entry.unit, 2), interval_text(name, ends, entry.unit)
        assert bool(interval) == (entry.kind not in ("count", "yes or no"))
        for saved, shown in zip((one, *ends), (value, *filter(None, interval.split(" to "))), strict=False):
            assert read(shown, value) == pytest.approx(saved, rel=0.05), name


@pytest.mark.parametrize("kind", ["metrics", "planners"])
@pytest.mark.parametrize("to", options.FORMATS)
@pytest.mark.parametrize("name", ["walk", NASTY, "=1+1", "half \ud800", "[x]", "* x"])
def test_every_format_takes_any_name_and_keeps_its_promise(kind: str, to: str, name: str) -> None:
    text = printed(kind, to, name)
    assert text.encode().endswith(b"\n")
    if to in ("table", "markdown", "latex"):
        assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f]", text)
        assert "0.3" in text
        assert "0.30000000000000004" not in text
    if to == "table":
        assert name != "walk" or max(map(len, text.split("\n\n")[0].splitlines())) <= 80
    if to == "markdown":
        assert ("eta_m" if kind == "metrics" else "planner") in cells_of(text)
    if to == "latex":
        assert text.startswith("% needs \\usepackage{booktabs}\n% ")
        assert text.splitlines()[-1].startswith("% ")
        rows = [line for line in text.splitlines() if line.endswith(r"\\")]
        assert {len(re.findall(r"(?<!\\)&", row)) for row in rows} == {4 if kind == "metrics" else 7}
        assert not any(row.lstrip().startswith(("[", "*")) for row in rows)
    if to == "csv":
        read = list(csv.DictReader(io.StringIO(text, newline="")))
        assert float(read[0]["value" if kind == "metrics" else "us_p95"]) == 0.1 + 0.2
        first = next(iter(read[0].values()))
        assert kind == "metrics" or first == csv_cell(name).encode("utf-8", "replace").decode()
        assert read[-1]["low" if kind == "metrics" else "ratio_low"] == ""
    if to == "json":
        (found,) = json.loads(text)
        assert found["eta_m" if kind == "metrics" else "us_p95"] == 0.1 + 0.2
        assert not {"ratio_low", "ratio_high", "fallback_share"} & set(found)


def test_readers_see_four_digits_ascii_nothing_for_no_value_and_folded_words() -> None:
    assert set(options.FORMATS) < set(FORMATS)  # a list of its own, so that the help needs no numpy
    head, *lines = print_table(HEADER, ROWS).splitlines()
    assert head.split() == ["name", "value", "n"]
    assert lines[0].split() == ["a_b", "0.1235", "1234567"]
    assert lines[1].split() == ["[x]", "0"]
    assert lines[2].endswith("-1.5       -3")
    assert {len(line) for line in lines} == {len(head)}
    row = ("/a/very/long/topic/name/of/a/camera", 12345.678, "as many words as it takes to fill a line and more")
    lines = print_table(("topic", "number", "why"), [row], width=60).splitlines()
    assert (max(map(len, lines)) <= 60, row[0] in lines[1], "12346" in lines[1]) == (True, True, True)


NARROW = {
    53: """\
name                      metres  count  why
測測測測測測測測測測測測    12.5      3  as many
                                         words as it
                                         takes
b                              1      2
""",
    44: """\
name             metres  count  why
測測測測測測測測測測測測
                   12.5      3  as many
                                words as it
                                takes
b                     1      2
""",
    22: """\
name
  metres  why
測測測測測測測測測測測測
    12.5  as many
          words as it
          takes
b
       1
left out in 22
    columns, but not
    in --json or
    --format csv:
    count
""",
}


@pytest.mark.parametrize("width", NARROW)
def test_a_narrow_table_folds_texts_then_gives_names_a_line_then_leaves_out_numbers(width: int) -> None:
    rows = [("測" * 12, 12.5, 3, "as many words as it takes"), ("b", 1.0, 2, "")]
    assert print_table(("name", "metres", "count", "why"), rows, width=width) == NARROW[width]


@settings(max_examples=50, deadline=None)
@given(st.text('abc&%$#_{}~^\\<>|`"[]* \n', max_size=30))
def test_latex_keeps_no_meaning_that_was_not_meant(text: str) -> None:
    body = print_table(("a", "b"), [(text, "x")], "latex").split("\\midrule\n")[1].split("\\bottomrule")[0]
    assert len(re.findall(r"(?<!\\)&", body)) == 1
    plain = re.sub(r"\\[&%$#_{}]|\\\^\{\}|\\[a-z]+\{[<>]?\}|\{\}|\\\\|&", "", body)
    assert not re.search(r"[&%$#_{}~^\\<>]", plain)


def test_a_few_runs_stand_side_by_side_and_many_are_summed_up_unless_their_settings_differ() -> None:
    beside, over = values_text({f"r{number}": {"eta_m": float(number)} for number in range(3)}).split("\n\n")
    assert beside.splitlines()[2].split() == ["eta_m", "0", "1", "2", "m"]
    name, mean, *_, lowest, highest, n = over.splitlines()[2].split()
    assert (name, mean, lowest, highest, n) == ("eta_m", "1", "0", "2", "3")
    names = [f"2024-05-0{day}-a-recording-of-a-long-walk" for day in range(1, 7)]
    assert metrics_text(runs(*names), "table").splitlines()[1].split()[:3] == ["metric", "mean", "95"]
    text = metrics_text(runs(*names), "table", ["planner.name: astar, ia_star"])
    heads = [line.split() for line in text.splitlines() if line.startswith("metric ")]
    assert heads == [["metric", *"ABCD", "unit"], ["metric", *"AB", "unit"]]
    assert f"A: {names[0]}" in text
    assert text.endswith("because their settings differ:\nplanner.name: astar, ia_star\n")
