from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose
from scipy.stats import chi2

from quadlog.results.plots.run_data import RunData
from quadlog.results.plots.style import render_png
from quadlog.results.plots.uwb_position import SHOWN_ELLIPSES, draw_uwb_error, draw_uwb_geometry
from quadlog.results.plots.uwb_ranges import draw_residuals, draw_uwb_links
from quadlog.results.run.maps import DilutionGrid, read_dilution, write_dilution
from quadlog.results.run.tables import TABLES, read_table, write_table
from quadlog.storage.formats.tum import write_tum


def axes_of(draw: Callable[[RunData], Figure | None], run: Path) -> Any:
    figure = draw(RunData(run))
    return figure.axes


def error_panels(run: Path) -> Any:
    return axes_of(draw_uwb_error, run)


def geometry(run: Path) -> Any:
    return axes_of(draw_uwb_geometry, run)[0]


def link_panels(run: Path) -> Any:
    return axes_of(draw_uwb_links, run)


def test_it_shows_errors_over_time_and_says_how_many_keep_the_bound(tiny_run: Path, change: Any) -> None:
    """Of 40 fixes 30 are off by 0.05 m and 10 by 0.5 m; every pose of the track by 0.05 m; the bound is 0.2 m."""
    errors = read_table(tiny_run, "uwb_errors")
    far = (errors["source"] == "fixes") & (np.arange(80) % 4 == 1)
    change(tiny_run, "uwb_errors", error_x_m=np.where(far, 0.3, 0.03), error_y_m=np.where(far, -0.4, 0.04))
    (panel,) = error_panels(tiny_run)
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


def test_every_tag_on_the_robot_has_a_panel(tiny_run: Path, change: Any) -> None:
    change(tiny_run, "uwb_errors", tag=np.arange(80) % 6)
    drawn = error_panels(tiny_run)
    assert [panel.get_title() for panel in drawn] == ["tag 0", "tag 1", "tag 2", "tag 3"]
    assert drawn[-1].get_xlabel() == "time (s)   (2 more tags not shown)"


@pytest.mark.parametrize("source", ["fixes", "track"])
def test_one_of_the_two_may_be_missing(tiny_run: Path, source: str) -> None:
    errors = read_table(tiny_run, "uwb_errors")
    kept = {name: column[errors["source"] == source] for name, column in errors.items()}
    write_table(tiny_run / "uwb_errors.parquet", TABLES["uwb_errors"], kept)
    (panel,) = error_panels(tiny_run)
    assert len(panel.get_lines()) == 2
    assert render_png(lambda: draw_uwb_error(RunData(tiny_run)))


def lines_of(axes: Any) -> dict[str, Any]:
    return {str(line.get_label()): line for line in axes.get_lines()}


def test_it_shows_map_anchors_fixes_and_tracks(tiny_original: Path) -> None:
    axes = geometry(tiny_original)
    (image,) = axes.images
    assert_allclose(image.get_extent(), [-3.0, 12.0, -6.0, 6.0])
    hdop = read_dilution(tiny_original).hdop
    shown = np.asarray(image.get_array())
    assert np.isfinite(shown).all()
    assert_allclose(shown[1:5, 12:18], hdop[1:5, 12:18])
    assert {"fixes, tags 0, 1", "robot, track", "target, track", "95 % ellipses of some", "anchors"} <= set(
        lines_of(axes)
    )
    assert "0" in [text.get_text() for text in axes.texts]
    assert axes.get_aspect() == 1.0


def test_ellipses_are_those_of_the_saved_covariances(tiny_run: Path, change: Any) -> None:
    change(tiny_run, "fixes", x_m=1.0, y_m=2.0, cov_xx_m2=0.04, cov_xy_m2=0.03, cov_yy_m2=0.05)
    outlines = [line for line in geometry(tiny_run).get_lines() if len(line.get_xdata()) == 61]
    assert len(outlines) == SHOWN_ELLIPSES
    off_m = np.stack([outlines[0].get_xdata() - 1.0, outlines[0].get_ydata() - 2.0], axis=1)
    distance2 = np.einsum("ni,ij,nj->n", off_m, np.linalg.inv([[0.04, 0.03], [0.03, 0.05]]), off_m)
    assert_allclose(distance2, chi2.ppf(0.95, 2))


def test_outliers_and_epochs_without_a_fix_are_left_out(tiny_original: Path) -> None:
    fixes = read_table(tiny_original, "fixes")
    good = np.isfinite(fixes["x_m"]) & ~fixes["outlier"]
    assert 0 < good.sum() < len(good)
    assert_allclose(lines_of(geometry(tiny_original))["fixes, tags 0, 1"].get_xdata(), fixes["x_m"][good])


def test_the_reference_is_drawn_where_uwb_was_compared_with_it(tiny_run: Path) -> None:
    assert "reference" not in lines_of(geometry(tiny_run))
    poses = read_table(tiny_run, "poses")
    write_tum(tiny_run / "reference.tum", poses["t_ns"], poses["x_m"], poses["y_m"], poses["yaw_rad"])
    assert_allclose(lines_of(geometry(tiny_run))["reference"].get_xdata(), poses["x_m"], atol=1e-6)
    (tiny_run / "uwb_errors.parquet").unlink()
    assert "reference" not in lines_of(geometry(tiny_run))


def test_tracks_of_other_sources_are_not_uwbs(tiny_run: Path, change: Any) -> None:
    change(tiny_run, "poses", source="odometry")
    assert "robot, track" not in lines_of(geometry(tiny_run))


@pytest.mark.parametrize(
    "hdop",
    [np.full((5, 7), np.inf), np.full((5, 7), 9.0), np.ones((1, 1)), np.full((3, 3), np.nan), np.full((4, 4), 0.7)],
    ids=["no fix", "poor", "one cell", "unknown", "flat"],
)
def test_maps_of_any_content_are_drawn(tiny_run: Path, hdop: np.ndarray) -> None:
    write_dilution(tiny_run, DilutionGrid(np.zeros(2), 1.0, 0.6, hdop))
    assert render_png(lambda: draw_uwb_geometry(RunData(tiny_run)))


def test_bars_are_the_saved_shares_at_their_anchors(tiny_run: Path, change: Any) -> None:
    change(tiny_run, "links", nlos_share=np.array([0.01, 0.02, 0.03, 0.04, 0.05, np.nan]))
    bars = link_panels(tiny_run)[2].patches
    assert_allclose([bar.get_height() for bar in bars], [1, 2, 3, 4, 5, np.nan])
    centre = np.array([bar.get_x() + bar.get_width() / 2 for bar in bars])
    assert_allclose(np.round(centre), [0, 1, 2, 0, 1, 2])
    assert len(np.unique(np.round(centre, 6))) == 6


def test_a_bias_that_is_not_applied_is_hollow(tiny_original: Path) -> None:
    links = read_table(tiny_original, "links")
    points = [
        line for line in link_panels(tiny_original)[1].get_lines() if line.get_marker() == "s" and len(line.get_xdata())
    ]
    hollow = [line for line in points if line.get_markerfacecolor() == "white"]
    assert_allclose(np.concatenate([line.get_ydata() for line in hollow]), links["bias_m"][~links["bias_applied"]])
    assert sum(len(line.get_xdata()) for line in points) == 6
    labels = link_panels(tiny_original)[1].get_legend_handles_labels()[1]
    assert labels == ["subtracted", "not applied"]


def test_residuals_are_their_quantiles(tiny_run: Path, change: Any) -> None:
    ranges = read_table(tiny_run, "ranges")
    first = (ranges["anchor"] == 0) & (ranges["tag"] == 0)
    residual_m = np.where(first, np.cumsum(first) / first.sum(), np.nan)
    change(tiny_run, "ranges", predicted_m=ranges["range_m"] - residual_m)
    thin, thick, dot, *rest = [line for line in link_panels(tiny_run)[0].get_lines() if len(line.get_xdata())]
    quantiles = [*thin.get_ydata(), *thick.get_ydata(), *dot.get_ydata()]
    assert_allclose(quantiles, np.percentile(residual_m[first], [5, 95, 25, 75, 50]))
    assert all(len(np.unique(line.get_ydata())) == 1 for line in rest)  # the zero line: other links have no residual


def test_without_calibration_it_says_so(tiny_run: Path, change: Any) -> None:
    change(tiny_run, "links", bias_m=np.full(6, np.nan), bias_std_m=np.full(6, np.nan), bias_applied=np.zeros(6, bool))
    bias = link_panels(tiny_run)[1]
    assert [text.get_text() for text in bias.texts] == ["no bias was estimated"]


def test_no_histogram_is_cut(tiny_run: Path, change: Any) -> None:
    """The first anchor's residuals scatter, those of the others are all alike: their bars are higher."""
    ranges = read_table(tiny_run, "ranges")
    first = ranges["anchor"] == ranges["anchor"].min()
    residual_m = np.where(first, np.linspace(-0.2, 0.2, len(first)), 0.01)
    change(tiny_run, "ranges", predicted_m=ranges["range_m"] - residual_m)
    panels = [panel for panel in axes_of(draw_residuals, tiny_run) if panel.get_visible()]
    tallest = max(patch.get_data().values.max() for panel in panels for patch in panel.patches)
    assert len(panels) > 1
    assert all(panel.get_ylim()[0] == 0 and panel.get_ylim()[1] > tallest for panel in panels)


def test_many_tags_and_anchors_are_drawn_in_part_and_that_is_said(tiny_run: Path) -> None:
    tag, anchor = (grid.ravel() for grid in np.meshgrid(np.arange(6), np.arange(30)))
    numbers = dict.fromkeys(("x_m", "y_m", "z_m", "residual_rms_m", "residual_median_m", "nlos_share"), 0.1)
    links = {"tag": tag, "anchor": anchor, "n": 3, "bias_m": 0.1, "bias_std_m": 0.01, "bias_applied": True}
    links |= {"why_not": "", "weak_first_path_share": 0.1}
    write_table(tiny_run / "links.parquet", TABLES["links"], links | numbers)
    assert link_panels(tiny_run)[2].get_xlabel() == "anchor (id)   (2 more tags and 14 more anchors not shown)"
    assert render_png(lambda: draw_uwb_links(RunData(tiny_run)))
