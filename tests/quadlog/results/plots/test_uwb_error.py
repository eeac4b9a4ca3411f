from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadlog.results.plots.run_data import RunData
from quadlog.results.plots.style import render_png
from quadlog.results.plots.uwb_position import draw_uwb_error
from quadlog.results.run.tables import TABLES, read_table, write_table


def panels(run: Path) -> Any:
    figure = draw_uwb_error(RunData(run))
    assert figure is not None
    return figure.axes


def test_it_shows_errors_over_time_and_says_how_many_keep_the_bound(tiny_run: Path) -> None:
    """Of 40 fixes 30 are off by 0.05 m and 10 by 0.5 m; every pose of the track by 0.05 m; the bound is 0.2 m."""
    errors = read_table(tiny_run, "uwb_errors")
    far = (errors["source"] == "fixes") & (np.arange(80) % 4 == 1)
    errors |= {"error_x_m": np.where(far, 0.3, 0.03), "error_y_m": np.where(far, -0.4, 0.04)}
    write_table(tiny_run / "uwb_errors.parquet", TABLES["uwb_errors"], errors)
    (panel,) = panels(tiny_run)
    lines = {str(line.get_label()): line for line in panel.get_lines()}
    rmse_m = np.sqrt(0.75 * 0.05**2 + 0.25 * 0.5**2)
    fixes, track = (
        f"fixes: RMSE {rmse_m:.3f} m, 75.0 % within the bound",
        "track: RMSE 0.050 m, 100.0 % within the bound",
    )
    assert set(lines) == {fixes, track, "fixes: 95 % bound claimed", "track: 95 % bound claimed"}
    assert_allclose(lines[fixes].get_ydata()[:2], [0.05, 0.5])
    assert_allclose(lines[fixes].get_xdata()[:2], [0.0, 0.1], atol=1e-9)
    assert_allclose(lines["track: 95 % bound claimed"].get_ydata(), 0.2)


def test_every_tag_on_the_robot_has_a_panel(tiny_run: Path) -> None:
    errors = read_table(tiny_run, "uwb_errors")
    errors["tag"] = np.arange(len(errors["t_ns"])) % 6
    write_table(tiny_run / "uwb_errors.parquet", TABLES["uwb_errors"], errors)
    drawn = panels(tiny_run)
    assert [panel.get_title() for panel in drawn] == ["tag 0", "tag 1", "tag 2", "tag 3"]
    assert drawn[-1].get_xlabel() == "time (s)   (2 more tags not shown)"


@pytest.mark.parametrize("source", ["fixes", "track"])
def test_one_of_the_two_may_be_missing(tiny_run: Path, source: str) -> None:
    errors = read_table(tiny_run, "uwb_errors")
    kept = {name: column[errors["source"] == source] for name, column in errors.items()}
    write_table(tiny_run / "uwb_errors.parquet", TABLES["uwb_errors"], kept)
    (panel,) = panels(tiny_run)
    assert len(panel.get_lines()) == 2
    assert render_png(lambda: draw_uwb_error(RunData(tiny_run)))
