from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

from quadlog.results.plots.run_data import RunData
from quadlog.results.plots.style import render_png
from quadlog.results.plots.uwb_position import SHOWN_ELLIPSES, draw_uwb_geometry
from quadlog.results.run.maps import DilutionGrid, read_dilution, write_dilution
from quadlog.results.run.tables import TABLES, read_table, write_table
from quadlog.storage.formats.tum import write_tum


def drawn(run: Path) -> Any:
    figure = draw_uwb_geometry(RunData(run))
    assert figure is not None
    return figure.axes[0]


def lines_of(axes: Any) -> dict[str, Any]:
    return {str(line.get_label()): line for line in axes.get_lines()}


def test_it_shows_map_anchors_fixes_and_tracks(tiny_original: Path) -> None:
    axes = drawn(tiny_original)
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


def test_ellipses_are_those_of_the_saved_covariances(tiny_run: Path) -> None:
    fixes = read_table(tiny_run, "fixes")
    count = len(fixes["t_ns"])
    fixes |= {"cov_xx_m2": np.full(count, 0.04), "cov_xy_m2": np.full(count, 0.03), "cov_yy_m2": np.full(count, 0.05)}
    fixes |= {"x_m": np.full(count, 1.0), "y_m": np.full(count, 2.0)}
    write_table(tiny_run / "fixes.parquet", TABLES["fixes"], fixes)
    outlines = [line for line in drawn(tiny_run).get_lines() if len(line.get_xdata()) == 61]
    assert len(outlines) == SHOWN_ELLIPSES
    off_m = np.stack([outlines[0].get_xdata() - 1.0, outlines[0].get_ydata() - 2.0], axis=1)
    distance2 = np.einsum("ni,ij,nj->n", off_m, np.linalg.inv([[0.04, 0.03], [0.03, 0.05]]), off_m)
    assert_allclose(distance2, chi2.ppf(0.95, 2))


def test_outliers_and_epochs_without_a_fix_are_left_out(tiny_original: Path) -> None:
    fixes = read_table(tiny_original, "fixes")
    good = np.isfinite(fixes["x_m"]) & ~fixes["outlier"]
    assert 0 < good.sum() < len(good)
    assert_allclose(lines_of(drawn(tiny_original))["fixes, tags 0, 1"].get_xdata(), fixes["x_m"][good])


def test_the_reference_is_drawn_where_uwb_was_compared_with_it(tiny_run: Path) -> None:
    assert "reference" not in lines_of(drawn(tiny_run))
    poses = read_table(tiny_run, "poses")
    write_tum(tiny_run / "reference.tum", poses["t_ns"], poses["x_m"], poses["y_m"], poses["yaw_rad"])
    assert_allclose(lines_of(drawn(tiny_run))["reference"].get_xdata(), poses["x_m"], atol=1e-6)
    (tiny_run / "uwb_errors.parquet").unlink()
    assert "reference" not in lines_of(drawn(tiny_run))


def test_tracks_of_other_sources_are_not_uwbs(tiny_run: Path) -> None:
    poses = read_table(tiny_run, "poses")
    poses["source"] = np.full(len(poses["t_ns"]), "odometry", dtype=object)
    write_table(tiny_run / "poses.parquet", TABLES["poses"], poses)
    assert "robot, track" not in lines_of(drawn(tiny_run))


@pytest.mark.parametrize(
    "hdop",
    [np.full((5, 7), np.inf), np.full((5, 7), 9.0), np.ones((1, 1)), np.full((3, 3), np.nan), np.full((4, 4), 0.7)],
    ids=["no fix", "poor", "one cell", "unknown", "flat"],
)
def test_maps_of_any_content_are_drawn(tiny_run: Path, hdop: np.ndarray) -> None:
    write_dilution(tiny_run, DilutionGrid(np.zeros(2), 1.0, 0.6, hdop))
    assert render_png(lambda: draw_uwb_geometry(RunData(tiny_run)))
