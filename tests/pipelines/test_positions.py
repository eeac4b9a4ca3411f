"""Positions, from mounts to the files that say how good UWB was: against SciPy, closed forms and the metrics."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from quadlog.config.schema import Config
from quadlog.messages import ImuSeries, Pose, PoseSeries, RangeSeries
from quadlog.pipelines.request import ReplayOutcome
from quadlog.pipelines.stages.mount import imu_in_base, moved_mounts
from quadlog.pipelines.stages.positions.uwb_tags import dilution_of, errors_of_tags, tag_truth
from quadlog.positioning.locate import Anchors, Located, LocateSettings, TagInfo, locate
from quadlog.recordings.tf_tree import TransformTree
from quadlog.results.tables import read_table
from tests.pipelines.conftest import fixture_request

T_NS = np.arange(5, dtype=np.int64)


def tree_with(mount: Rotation, *, static: bool = True) -> TransformTree:
    """The mount once, or again and again on a topic of moving transforms, with a quaternion of either sign."""
    tree = TransformTree()
    for t_ns, sign in enumerate([1] if static else [1, -1, 1]):
        tree.add(t_ns, Pose(t_ns, "base_link", "imu", np.array([0.1, 0.0, 0.2]), sign * mount.as_quat()), static=static)
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


@pytest.mark.parametrize("frame_id", ["imu", "elsewhere", ""])
def test_without_a_mount_that_turns_it_stays_as_it_came(frame_id: str) -> None:
    seen = ImuSeries(T_NS, np.ones((5, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (5, 1)), frame_id)
    assert imu_in_base(seen, tree_with(Rotation.identity())) is seen
    assert imu_in_base(seen, TransformTree()) is seen


def test_a_mount_that_changes_after_all_is_told() -> None:
    tree = tree_with(Rotation.identity(), static=False)
    assert moved_mounts([("imu", "base_link")], tree) == []
    tree.add(9, Pose(9, "base_link", "imu", np.array([0.1, 0.0, 0.3]), np.array([0, 0, 0, 1.0])), static=False)
    (warning,) = moved_mounts([("imu", "base_link")], tree)
    assert warning.startswith("the transform from base_link to imu changes")


LATE_NS = 1_700_000_000_000_000_000 + np.arange(5, dtype=np.int64) * 50_000_000


def test_the_truth_of_a_tag_turns_with_the_robot_and_is_unknown_where_the_reference_is_silent():
    rotation = Rotation.from_euler("z", np.linspace(-3, 3, 5)[:, None])
    position_m = np.column_stack([np.arange(5.0), -np.arange(5.0), np.full(5, 0.3)])
    poses = PoseSeries(LATE_NS, position_m, rotation.as_quat())
    expected = position_m + rotation.apply([0.4, -0.2, 0.0])
    assert_allclose(tag_truth(LATE_NS, poses, (0.4, -0.2)), expected[:, :2], atol=1e-12)
    assert np.isnan(tag_truth(LATE_NS[[0, -1]] + [-1, 1], poses, (0.0, 0.0))).all()
    gap = PoseSeries(LATE_NS[[0, 4]], position_m[[0, 4]], poses.quat_xyzw[[0, 4]])
    assert np.isnan(tag_truth(LATE_NS[2:3], gap, (0.0, 0.0))).all()


ANCHORS_M = np.array([[0.0, 0.0, 1.2], [8.0, 0.0, 1.2], [8.0, 7.0, 1.2], [0.0, 7.0, 1.2], [50.0, 50.0, 1.2]])


def standing(seed: int) -> tuple[Located, PoseSeries]:
    """Ranges to the first four anchors of a robot that stands, and its true poses over the middle of the log."""
    t_ns = 1_700_000_000_000_000_000 + np.arange(400, dtype=np.int64) * 20_000_000
    true_m = np.linalg.norm(np.array([3.0, 3.0, 0.6]) - ANCHORS_M[:4], axis=1)
    range_m = np.tile(true_m, 400) + 0.1 * np.random.default_rng(seed).standard_normal(1600)
    series = RangeSeries(np.repeat(t_ns, 4), np.zeros(1600, np.int64), np.tile(np.arange(4), 400), range_m)
    anchors = Anchors(np.arange(5), ANCHORS_M, np.zeros(5))
    located = locate(series, anchors, [TagInfo(0, 0.6)], LocateSettings(calibrate=False))
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (200, 1))
    return located, PoseSeries(t_ns[100:300], np.tile([3.0, 3.0, 0.3], (200, 1)), quat)


def test_white_noise_stays_within_the_claimed_bound():
    """19 in 20 fixes; the track of a robot that stands is one long error, which is only to be smaller."""
    inside = []
    for seed in range(5):
        located, reference = standing(seed)
        errors = errors_of_tags(located, {0: (0.0, 0.0)}, reference)[0]
        assert_allclose(errors["fixes"].error_m, located.tags[0].fixes.position_m[100:300] - 3.0)
        inside.append(np.mean(errors["fixes"].distance_m <= errors["fixes"].bound_m))
        assert np.median(errors["track"].bound_m) < np.median(errors["fixes"].bound_m)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)


def test_the_map_of_dilution_rests_on_the_anchors_that_were_heard():
    """Anchor 4 is far away and silent: with it the map would reach to 50 m."""
    anchors = [{"id": i, "x_m": x, "y_m": y, "z_m": z} for i, (x, y, z) in enumerate(ANCHORS_M.tolist())]
    grid = dilution_of(standing(0)[0], 0, Config.model_validate({"uwb": {"anchors": anchors}}), 40, 40)
    assert grid.tag_height_m == 0.6
    assert (grid.origin_m + np.array(grid.hdop.shape[::-1]) * grid.cell_m < 12).all()


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
