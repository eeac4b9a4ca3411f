"""Positions, from mounts to the files that say how good UWB was: against SciPy, closed forms and the metrics."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from quadlog.config.file import load_config
from quadlog.messages import ImuSeries
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import ReplayOptions, ReplayOutcome, ReplayRequest
from quadlog.pipelines.simulation.synthesize import make_recording, synthesize
from quadlog.pipelines.stages.mount import imu_in_base, moved_mounts
from quadlog.recordings.tf_tree import TransformTree
from quadlog.results.tables import read_table
from tests.pipelines.conftest import fixture_request

T_NS = np.arange(5, dtype=np.int64)


def tree_with(mount: Rotation, *, static: bool = True, heights_m: tuple[float, ...] = (0.2, 0.2, 0.2)) -> TransformTree:
    """The mount once, or again and again on a topic of moving transforms, with a quaternion of either sign."""
    tree = TransformTree()
    rows = [[0.1, 0.0, z_m, *(-1) ** i * mount.as_quat()] for i, z_m in enumerate(heights_m)]
    tree.add("/tf", "base_link", "imu", np.arange(len(rows)), np.array(rows), static=static)
    return tree


@pytest.mark.parametrize("static", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_orientation_and_rates_become_those_of_base(seed: int, static: bool) -> None:
    """Against two poses of base: the rate in base is what turns one into the other."""
    random = np.random.default_rng(seed)
    mount, base_in_world = Rotation.random(rng=random), Rotation.random(5, rng=random)
    rate_in_base = random.normal(0, 1, (5, 3))
    seen = ImuSeries(T_NS, mount.inv().apply(rate_in_base), (base_in_world * mount).as_quat(), "imu")
    found = imu_in_base(seen, tree_with(mount, static=static))
    assert found.quat_xyzw is not None
    assert (Rotation.from_quat(found.quat_xyzw) * base_in_world.inv()).magnitude() == pytest.approx(0, abs=1e-9)
    assert found.angular_radps == pytest.approx(rate_in_base)
    assert found.frame_id == "base_link"


def test_a_mount_that_changes_after_all_is_told() -> None:
    assert moved_mounts([("imu", "base_link")], tree_with(Rotation.identity(), static=False)) == []
    moved = tree_with(Rotation.identity(), static=False, heights_m=(0.2, 0.2, 0.3))
    (warning,) = moved_mounts([("imu", "base_link")], moved)
    assert warning.startswith("the transform from base_link to imu changes")


def test_links_are_what_the_saved_ranges_show(located_run: ReplayOutcome):
    links, ranges = read_table(located_run.run, "links"), read_table(located_run.run, "ranges")
    anchors = fixture_request(located_run.run).config.uwb.anchors
    assert list(zip(links["tag"], links["anchor"], strict=True)) == [(t, a.id) for t in (0, 1) for a in anchors]
    assert_allclose(links["x_m"], [anchor.x_m for anchor in anchors] * 2)
    assert_allclose(links["z_m"], [anchor.z_m for anchor in anchors] * 2)
    residual_m = ranges["range_m"] - ranges["predicted_m"]
    for index, (tag, anchor) in enumerate(zip(links["tag"], links["anchor"], strict=True)):
        mine_m = residual_m[(ranges["tag"] == tag) & (ranges["anchor"] == anchor) & np.isfinite(residual_m)]
        assert links["n"][index] == len(mine_m)
        assert links["residual_rms_m"][index] == pytest.approx(np.sqrt(np.mean(mine_m**2)))
        assert links["nlos_share"][index] == pytest.approx(np.mean(mine_m > 3 * links["range_std_m"][index]))
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


@pytest.mark.parametrize("scenario", ["forest", "corridor"])
def test_a_replay_finds_the_robot_with_ranges_that_fit(tmp_path, scenario):
    path, config_path = tmp_path / "walk.mcap", tmp_path / "walk.toml"
    synthesize(make_recording(scenario, seed=2, duration_s=20.0, azimuth_steps=16), path, config_output=config_path)
    config = load_config(config_path)
    request = ReplayRequest(path, tmp_path / "run", config, ReplayOptions(until="position"), plots=False)
    outcome = replay(request, Silent())
    assert outcome.exit_code == 0
    record = json.loads((outcome.run / "run.json").read_text())
    assert not [each for each in record["warnings"] if "check [[uwb.anchors]]" in each or "epochs" in each]
    # In the corridor half of the ranges come through walls, 0.4 m late on average.
    assert outcome.metrics["ate_rmse_m"]["value"] < (0.5 if scenario == "corridor" else 0.25)


@pytest.mark.parametrize(("given_m", "warned"), [(0.3, True), (0.1, False), (0.01, True)])
def test_a_configured_noise_that_is_far_off_is_warned_of(tmp_path, given_m, warned):
    """Ranges of the fixture scatter by 0.1 m."""
    request = fixture_request(tmp_path / "run", until="position")
    uwb = request.config.uwb.model_copy(update={"range_std_m": given_m})
    request = replace(request, config=request.config.model_copy(update={"uwb": uwb}), plots=False)
    record = json.loads((replay(request, Silent()).run / "run.json").read_text())
    assert any("leave it out, and it is estimated" in each for each in record["warnings"]) == warned
