"""The files that tell how good UWB was, as a replay of the committed recording leaves them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import ReplayOutcome, ReplayRequest
from quadlog.positioning.dilution import dilution_at
from quadlog.results.arrays import read_arrays
from quadlog.results.tables import read_table


def test_links_are_what_the_saved_ranges_show(located_run: ReplayOutcome, follow_request: Callable[..., ReplayRequest]):
    links, ranges = read_table(located_run.run, "links"), read_table(located_run.run, "ranges")
    anchors = follow_request(located_run.run).config.uwb.anchors
    assert list(zip(links["tag"], links["anchor"], strict=True)) == [(t, a.id) for t in (0, 1) for a in anchors]
    assert_allclose(links["x_m"], [anchor.x_m for anchor in anchors] * 2)
    assert_allclose(links["z_m"], [anchor.z_m for anchor in anchors] * 2)
    residual_m = ranges["range_m"] - ranges["predicted_m"]
    for index, (tag, anchor) in enumerate(zip(links["tag"], links["anchor"], strict=True)):
        mine_m = residual_m[(ranges["tag"] == tag) & (ranges["anchor"] == anchor) & np.isfinite(residual_m)]
        assert links["n"][index] == len(mine_m)
        assert links["residual_rms_m"][index] == pytest.approx(np.sqrt(np.mean(mine_m**2)))
        assert links["nlos_share"][index] == pytest.approx(np.mean(mine_m > 0.3))
    assert np.isnan(links["weak_first_path_share"]).all()
    assert ((links["why_not"] == "") == links["bias_applied"]).all()


def test_errors_agree_with_the_metric(located_run: ReplayOutcome):
    errors = read_table(located_run.run, "uwb_errors")
    assert set(errors["tag"]) == {0}
    fixes, track = errors["source"] == "fixes", errors["source"] == "track"
    assert (fixes | track).all()
    length_m = np.hypot(errors["error_x_m"], errors["error_y_m"])
    assert np.sqrt(np.mean(length_m[fixes] ** 2)) == pytest.approx(located_run.metrics["uwb_rmse_m"]["value"])
    assert fixes.sum() == located_run.metrics["uwb_rmse_m"]["n"]
    assert (errors["bound_m"] > 0).all()
    # Ellipses of fixes know of white noise alone; those of the track hold what reflections and biases do.
    inside = length_m[track] <= errors["bound_m"][track]
    assert inside.mean() == located_run.metrics["uwb_coverage_95"]["value"] > 0.9
    nees = -2 * np.log(0.05) * (length_m[track] / errors["bound_m"][track]) ** 2
    assert nees.mean() == pytest.approx(located_run.metrics["uwb_nees"]["value"])


def test_innovations_are_saved_for_every_instant_of_a_track(located_run: ReplayOutcome):
    table = read_table(located_run.run, "innovations")
    assert set(table["tag"]) == {0, 1}
    own = table["tag"] == 0
    assert (np.diff(table["t_ns"][own]) > 0).all()
    assert (table["n_ranges"] > 0).all()
    assert table["nis"][own].mean() == pytest.approx(located_run.metrics["uwb_nis"]["value"])
    assert 0.3 < located_run.metrics["uwb_nis"]["value"] < 3


def test_the_saved_map_is_that_of_the_robots_tag(
    located_run: ReplayOutcome, follow_request: Callable[..., ReplayRequest]
):
    grid = read_arrays(located_run.run, "dilution")
    anchors = follow_request(located_run.run).config.uwb.anchors
    assert grid["tag_height_m"] == 0.6
    assert max(grid["hdop"].shape) > 60
    centre_m = grid["origin_m"] + (np.array([30, 20]) + 0.5) * grid["cell_m"]
    anchors_m = np.array([(each.x_m, each.y_m, each.z_m) for each in anchors])
    assert_allclose(dilution_at(centre_m[None], anchors_m, 0.6), grid["hdop"][20, 30])


def test_without_a_reference_there_are_no_errors(tmp_path: Path, follow_request: Callable[..., ReplayRequest]):
    """Two poses could be the truth, and none is taken without being told."""
    request = follow_request(tmp_path / "run", until="position", duration_s=1.0)
    topics = request.config.topics.model_copy(update={"reference": ""})
    request = replace(request, config=request.config.model_copy(update={"topics": topics}))
    outcome = replay(request, Silent())
    names = {path.name for path in outcome.run.iterdir()}
    assert {"links.parquet", "dilution.npz"} <= names
    assert "uwb_errors.parquet" not in names
    assert not (outcome.run / "plots" / "uwb_error.png").exists()
