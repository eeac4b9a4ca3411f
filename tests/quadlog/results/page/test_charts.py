import hashlib
import json
import math
import re
from html.parser import HTMLParser
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from quadlog.results.page.charts import (
    COLORS,
    PANEL_POINTS,
    ChartPanel,
    Line,
    panel_json,
    rounded,
    row_runs,
    run_charts,
    to_script_json,
)
from quadlog.results.plots.run_data import RunData
from quadlog.results.run.tables import TABLES, read_table, write_table


def test_charts_show_what_the_tables_hold(tiny_run: Path) -> None:
    charts = run_charts(RunData(tiny_run))
    control, ranges = read_table(tiny_run, "control"), read_table(tiny_run, "ranges")
    distance = charts["tracking_error"]["panels"][0]
    assert [line["label"] for line in distance["lines"]] == ["to the timed reference", "to the path", "mean eta_m"]
    assert distance["seconds"] == pytest.approx(np.arange(200) * 0.02)
    assert distance["values"][1] == pytest.approx(control["error_m"].tolist(), abs=1e-4)
    assert [panel["what"] for panel in charts["expanded"]["panels"]] == [
        "cells per replan (count), logged walk",
        "cells per replan (count), re-simulated walk",
    ]
    measured, residuals = charts["ranges"]["panels"]
    assert measured["values"][1] == pytest.approx(ranges["range_m"][ranges["anchor"] == 1].tolist(), abs=1e-3)
    second = ranges["anchor"] == 1
    expected = (ranges["range_m"] - ranges["predicted_m"])[second]
    assert residuals["values"][1] == pytest.approx(expected.tolist(), abs=1e-3)
    assert [line["points"] for line in residuals["lines"]] == [True, True, True, False]  # the last is the NLOS limit
    assert "posture" not in charts  # a robot without a body
    assert "torques" not in charts


def test_logged_and_re_simulated_walks_lie_over_each_other(tiny_run: Path) -> None:
    chart = run_charts(RunData(tiny_run))["trajectory"]
    assert [walk["label"] for walk in chart["walks"]] == ["robot", "target", "re-simulated walk"]
    for walk, name in zip(chart["walks"], ("poses", "target", "control"), strict=True):
        table = read_table(tiny_run, name)
        assert walk["x"] == pytest.approx(table["x_m"].tolist(), abs=1e-3)
        assert walk["y"] == pytest.approx(table["y_m"].tolist(), abs=1e-3)
        assert len(walk["seconds"]) == len(walk["x"])
    assert chart["anchors"] == [{"label": "0", "x": 0.0, "y": 5.0}]


def test_torques_have_a_panel_for_each_leg(tiny_run: Path) -> None:
    control = read_table(tiny_run, "control") | {
        f"tau_{joint:02d}_nm": np.full(200, float(joint)) for joint in range(12)
    }
    write_table(tiny_run / "control.parquet", TABLES["control"], control)
    panels = run_charts(RunData(tiny_run))["torques"]["panels"]
    assert [panel["values"][0][0] for panel in panels] == [0.0, 3.0, 6.0, 9.0]
    assert [[line["label"] for line in panel["lines"]] for panel in panels][3] == ["RR hip", "RR thigh", "RR calf"]


def test_charts_stand_beside_pictures_and_none_has_numbers_alone(reported: Path) -> None:
    page = (reported / "report.html").read_text()
    data = re.search(r'<script type="application/json" id="chart-data">(.*?)</script>', page, re.DOTALL)
    charts = json.loads(data[1])
    assert sorted(re.findall(r'data-chart="(\w+)" hidden', page)) == sorted(charts)
    assert {"trajectory", "ranges", "uwb_error", "scans", "expanded", "tracking_error", "lookahead"} <= set(charts)
    assert {f"{name}.png" for name in charts} <= {path.name for path in (reported / "plots").iterdir()}


@given(hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, max_side=12)))
def test_runs_of_cells_are_the_cells_and_as_few_as_can_be(cells: np.ndarray) -> None:
    again = np.zeros_like(cells)
    runs = row_runs(cells)
    for row, first, length in runs:
        again[row, first : first + length] = True
    assert np.array_equal(again, cells)
    assert len(runs) == sum(len(re.findall("1+", "".join("01"[value] for value in row))) for row in cells.astype(int))


def _luminance(color: str) -> float:
    """Relative luminance of #rrggbb [WCAG 2.2]."""
    parts = [int(color[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize("theme", [0, 1], ids=["light", "dark"])
def test_lines_can_be_told_from_their_ground(theme: int) -> None:
    css = (resources.files("quadlog.results.page") / "templates" / "report.css").read_text()
    root = re.findall(r":root \{(.*?)\}", css, re.DOTALL)[theme]
    colors = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", root))
    for name in COLORS:
        light, dark = sorted((_luminance(colors[name]), _luminance(colors["card"])), reverse=True)
        assert (light + 0.05) / (dark + 0.05) >= 3.0, name  # what WCAG asks of graphics


def test_every_colour_of_a_chart_has_a_name_in_the_page(tiny_run: Path) -> None:
    charts = run_charts(RunData(tiny_run))
    used = {line["color"] for chart in charts.values() for panel in chart.get("panels", []) for line in panel["lines"]}
    used |= {walk["color"] for walk in charts["trajectory"]["walks"]}
    assert used <= set(COLORS)


def test_uplot_is_the_file_it_says_it_is() -> None:
    vendor = resources.files("quadlog.results.page") / "templates" / "vendor"
    stated = dict(re.findall(r"\| (\S+) \| ([0-9a-f]{64}) \|", (vendor / "ORIGIN.md").read_text()))
    assert set(stated) == {"uPlot.iife.min.js", "uPlot.min.css"}
    for name, digest in stated.items():
        assert hashlib.sha256((vendor / name).read_bytes()).hexdigest() == digest
    assert stated["uPlot.iife.min.js"].startswith("19c8d4c6ad88929a")
    assert "MIT" in (vendor / "uPlot.LICENSE.txt").read_text()


SERIES = hnp.arrays(np.float64, st.integers(1, 300), elements=st.floats(-1e9, 1e9) | st.just(math.nan))


class Elements(HTMLParser):
    """Every start and end of an element, and the text in between."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.found.append(tag)

    def handle_endtag(self, tag: str) -> None:
        self.found.append("/" + tag)


@given(st.text() | st.sampled_from(["</script><script>alert(1)</script>", "<!-- <script>", "\u2028", "]]>", "&lt;"]))
def test_any_text_survives_inside_a_script_and_ends_nothing(text: str) -> None:
    inside = to_script_json({text: [text]})
    assert json.loads(inside) == {text: [text]}
    assert Elements(f"<script>{inside}</script>").found == ["script", "/script"]
    assert inside.isascii()
    assert not set("<>&") & set(inside)


@given(SERIES)
def test_rounding_is_finer_than_a_pixel_and_leaves_gaps(values: np.ndarray) -> None:
    short = rounded(values)
    span = np.nanmax(values) - np.nanmin(values) if np.isfinite(values).any() else 0.0
    size = span or np.nanmax(np.abs(values), initial=0)
    for value, given_value in zip(short, values, strict=True):
        assert (value is None) == math.isnan(given_value)
        if value is not None:
            assert abs(value - given_value) <= 1e-3 * size + 1e-12
    json.dumps(short, allow_nan=False)


def test_numbers_are_short() -> None:
    assert rounded(np.array([0.123456789, 1.0, -0.0])) == [0.1235, 1.0, 0.0]
    assert rounded(np.array([0.000123456789, 0.0])) == [0.00012346, 0.0]
    assert rounded(np.array([123456.789, 0.0])) == [123457.0, 0.0]


@given(hnp.arrays(np.float64, 10_000, elements=st.floats(-1, 1), fill=st.just(0.0)))
def test_no_peak_is_lost_however_long_the_run(values: np.ndarray) -> None:
    seconds = np.arange(10_000) * 0.01
    drawn = panel_json(
        ChartPanel("error (m)", [Line("a", "robot", seconds, values), Line("b", "plan", seconds, -values)])
    )
    assert not drawn["joined"]
    assert len(drawn["seconds"]) <= 2 * (PANEL_POINTS + 2)
    assert drawn["seconds"] == sorted(drawn["seconds"])
    assert abs(max(drawn["values"][0]) - values.max()) <= 1e-3
    assert abs(min(drawn["values"][0]) - values.min()) <= 1e-3
    assert drawn["values"][1] == [-value + 0.0 for value in drawn["values"][0]]


def test_lines_of_other_instants_have_no_value_where_they_have_no_row() -> None:
    odd, even = np.array([1.0, 3.0]), np.array([2.0, 3.0])
    drawn = panel_json(
        ChartPanel("error (m)", [Line("a", "robot", odd, odd), Line("b", "plan", even, 10 * even, points=True)])
    )
    assert drawn["joined"]
    assert drawn["seconds"] == [1.0, 2.0, 3.0]
    assert drawn["values"] == [[1.0, None, 3.0], [None, 20.0, 30.0]]
    assert [line["points"] for line in drawn["lines"]] == [False, True]


def test_lines_without_a_value_are_left_out_and_none_is_no_panel() -> None:
    seconds = np.arange(3.0)
    nothing = Line("a", "robot", seconds, np.full(3, np.nan))
    drawn = panel_json(ChartPanel("gain (1)", [nothing, Line("b", "plan", seconds, seconds)]))
    assert [line["label"] for line in drawn["lines"]] == ["b"]
    assert panel_json(ChartPanel("gain (1)", [nothing])) is None
    assert panel_json(ChartPanel("gain (1)", [Line("a", "robot", np.empty(0), np.empty(0))])) is None
