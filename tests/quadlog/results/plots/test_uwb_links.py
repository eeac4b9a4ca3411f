from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.testing import assert_allclose

from quadlog.results.plots.run_data import RunData
from quadlog.results.plots.style import render_png
from quadlog.results.plots.uwb_ranges import draw_uwb_links
from quadlog.results.run.tables import TABLES, read_table, write_table


def change(run: Path, name: str, **columns: Any) -> None:
    write_table(run / f"{name}.parquet", TABLES[name], read_table(run, name) | columns)


def panels(run: Path) -> Any:
    figure = draw_uwb_links(RunData(run))
    assert figure is not None
    return figure.axes


def test_bars_are_the_saved_shares_at_their_anchors(tiny_run: Path) -> None:
    change(tiny_run, "links", nlos_share=np.array([0.01, 0.02, 0.03, 0.04, 0.05, np.nan]))
    bars = panels(tiny_run)[2].patches
    assert_allclose([bar.get_height() for bar in bars], [1, 2, 3, 4, 5, np.nan])
    centre = np.array([bar.get_x() + bar.get_width() / 2 for bar in bars])
    assert_allclose(np.round(centre), [0, 1, 2, 0, 1, 2])
    assert len(np.unique(np.round(centre, 6))) == 6


def test_a_bias_that_is_not_applied_is_hollow(tiny_original: Path) -> None:
    links = read_table(tiny_original, "links")
    points = [
        line for line in panels(tiny_original)[1].get_lines() if line.get_marker() == "s" and len(line.get_xdata())
    ]
    hollow = [line for line in points if line.get_markerfacecolor() == "white"]
    assert_allclose(np.concatenate([line.get_ydata() for line in hollow]), links["bias_m"][~links["bias_applied"]])
    assert sum(len(line.get_xdata()) for line in points) == 6
    labels = panels(tiny_original)[1].get_legend_handles_labels()[1]
    assert labels == ["subtracted", "not applied"]


def test_residuals_are_their_quantiles(tiny_run: Path) -> None:
    ranges = read_table(tiny_run, "ranges")
    first = (ranges["anchor"] == 0) & (ranges["tag"] == 0)
    residual_m = np.where(first, np.cumsum(first) / first.sum(), np.nan)
    change(tiny_run, "ranges", predicted_m=ranges["range_m"] - residual_m)
    thin, thick, dot, *rest = [line for line in panels(tiny_run)[0].get_lines() if len(line.get_xdata())]
    quantiles = [*thin.get_ydata(), *thick.get_ydata(), *dot.get_ydata()]
    assert_allclose(quantiles, np.percentile(residual_m[first], [5, 95, 25, 75, 50]))
    assert all(len(np.unique(line.get_ydata())) == 1 for line in rest)  # the zero line: other links have no residual


def test_without_calibration_it_says_so(tiny_run: Path) -> None:
    change(tiny_run, "links", bias_m=np.full(6, np.nan), bias_std_m=np.full(6, np.nan), bias_applied=np.zeros(6, bool))
    bias = panels(tiny_run)[1]
    assert [text.get_text() for text in bias.texts] == ["no bias was estimated"]


def test_many_tags_and_anchors_are_drawn_in_part_and_that_is_said(tiny_run: Path) -> None:
    tag, anchor = (grid.ravel() for grid in np.meshgrid(np.arange(6), np.arange(30)))
    numbers = dict.fromkeys(("x_m", "y_m", "z_m", "residual_rms_m", "residual_median_m", "nlos_share"), 0.1)
    links = {"tag": tag, "anchor": anchor, "n": 3, "bias_m": 0.1, "bias_std_m": 0.01, "bias_applied": True}
    links |= {"why_not": "", "weak_first_path_share": 0.1}
    write_table(tiny_run / "links.parquet", TABLES["links"], links | numbers)
    assert panels(tiny_run)[2].get_xlabel() == "anchor (id)   (2 more tags and 14 more anchors not shown)"
    assert render_png(lambda: draw_uwb_links(RunData(tiny_run)))
