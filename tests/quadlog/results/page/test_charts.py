import hashlib
import json
import re
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra import numpy as hnp

from quadlog.results.page.charts import COLORS, row_runs, run_charts
from quadlog.results.plots.run_data import RunData
from quadlog.results.run.tables import TABLES, read_table, write_table


def test_charts_show_what_the_tables_hold(tiny_run: Path) -> None:
    charts = run_charts(RunData(tiny_run))
    control, ranges = read_table(tiny_run, "control"), read_table(tiny_run, "ranges")
    distance = charts["tracking_error"]["panels"][0]
    assert [line["label"] for line in distance["lines"]] == ["to the timed reference", "to the path"]
    assert distance["seconds"] == pytest.approx(np.arange(200) * 0.02)
    assert distance["values"][1] == pytest.approx(control["error_m"].tolist(), abs=1e-4)
    assert [panel["what"] for panel in charts["expanded"]["panels"]] == [
        "cells per replan (count), logged walk",
        "cells per replan (count), re-simulated walk",
    ]
    (residuals,) = charts["ranges"]["panels"]
    second = ranges["anchor"] == 1
    expected = (ranges["range_m"] - ranges["predicted_m"])[second]
    assert residuals["values"][1] == pytest.approx(expected.tolist(), abs=1e-3)
    assert all(line["points"] for line in residuals["lines"])
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
    assert [[line["label"] for line in panel["lines"]] for panel in panels][3] == ["τ09", "τ10", "τ11"]


def test_charts_stand_beside_pictures_and_none_has_numbers_alone(reported: Path) -> None:
    page = (reported / "report.html").read_text()
    data = re.search(r'<script type="application/json" id="chart-data">(.*?)</script>', page, re.DOTALL)
    assert data is not None
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
