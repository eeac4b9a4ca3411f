from __future__ import annotations

import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core import sync
from evo.core.trajectory import Plane, PoseTrajectory3D
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.messages import PoseSeries
from quadlog.metrics.alignment import (
    align_rigidly,
    find_frame_offset,
    frame_offset_words,
    mirror_words,
    project_to_plane,
)
from quadlog.metrics.positioning import associate, fix_error_samples, positions_at, residual_samples
from quadlog.metrics.reference_offset import compare_trajectories
from quadlog.metrics.summary import interval_of, metrics_of


def trajectory(rng, t_ns, flat=False):
    steps_m = rng.normal(size=(len(t_ns), 3)) * ([1, 1, 0] if flat else [1, 1, 1])
    return PoseSeries(t_ns, steps_m.cumsum(axis=0), Rotation.random(len(t_ns), rng=rng).as_quat())


def as_evo(ours):
    stamps_s = np.array([float(f"{t // 10**9}.{t % 10**9:09d}") for t in ours.t_ns.tolist()])  # as in a TUM file
    return PoseTrajectory3D(ours.position_m, np.roll(ours.quat_xyzw, 1, axis=1), stamps_s)


@pytest.mark.parametrize(("start_ns", "offset_s"), [(0, 0.0), (17 * 10**17, 0.0), (10**10, -0.37), (10**10, 2.5)])
@pytest.mark.parametrize("counts", [(300, 100), (100, 300), (200, 200)])
def test_equal_to_evo(counts, start_ns, offset_s):
    """Pairs, with an offset added to the second's times, and the errors of these."""
    rng = np.random.default_rng(len(counts) + counts[0])
    one_ns, other_ns = (np.sort(rng.choice(3000, n, replace=False)) * 1_000_000 + start_ns for n in counts)
    other_ns = other_ns - round(offset_s * 1e9)
    reference, estimate = trajectory(rng, one_ns), trajectory(rng, other_ns)
    paired = sync.associate_trajectories(as_evo(reference), as_evo(estimate), max_diff=0.01, offset_2=offset_s)
    assert paired[0].num_poses > 50
    for ours, theirs, rows in zip(
        (reference, estimate), paired, associate(one_ns, other_ns, 0.01, offset_s), strict=True
    ):
        np.testing.assert_allclose(ours.position_m[rows], theirs.positions_xyz)
    found = metrics_of(compare_trajectories(reference, estimate, 0.01, offset_s).samples)
    assert found["ate_rmse_m"].n == paired[0].num_poses
    for name, metric in (
        ("ate_rmse_m", evo_metrics.APE(evo_metrics.PoseRelation.translation_part)),
        ("rpe_rmse_m", evo_metrics.RPE(evo_metrics.PoseRelation.translation_part, 1, evo_metrics.Unit.frames)),
    ):
        metric.process_data(paired)
        rmse_m = metric.get_statistic(evo_metrics.StatisticsType.rmse)
        assert found[name].value == pytest.approx(rmse_m, abs=1e-9)


def test_uwb_by_hand():
    t_ns = np.arange(3)
    samples = fix_error_samples(t_ns, np.array([[3.0, 4.0], [3.0, -4.0], [np.nan, 0.0]]))
    metrics = metrics_of(samples | residual_samples(t_ns, np.array([0.1, 0.2, np.nan]), np.array([3, 1, 4])))
    assert (metrics["uwb_rmse_m"].value, metrics["uwb_rmse_m"].n) == (5.0, 2)
    assert (metrics["uwb_bias_m"].value, metrics["uwb_bias_m"].n) == (3.0, 2)
    assert metrics["uwb_residual_m"].value == pytest.approx(np.sqrt((3 * 0.01 + 0.04) / 4))
    assert metrics["uwb_residual_m"].n == 4
    assert metrics_of(residual_samples(t_ns, np.full(3, np.nan), np.zeros(3, dtype=int))) == {}


def test_positions_between_poses():
    known_ns, known_m = np.array([0, 100, 1000]), np.array([[0.0, 0, 0], [1, 2, 3], [9, 9, 9]])
    found = positions_at(np.array([-1, 0, 50, 100, 500, 1000, 1001]), known_ns, known_m, max_gap_ns=200)
    np.testing.assert_allclose(found[[1, 2, 3, 5]], [[0, 0, 0], [0.5, 1, 1.5], [1, 2, 3], [9, 9, 9]])
    assert np.isnan(found[[0, 4, 6]]).all()
    assert np.isnan(positions_at(np.array([3]), known_ns[:0], known_m[:0], 10)).all()


def test_the_interval_of_a_bias_excludes_zero_in_a_twentieth_of_the_logs_that_have_none():
    rng = np.random.default_rng(5)
    lows = []
    for _ in range(400):
        bias = fix_error_samples(np.arange(200), rng.normal(0, [0.1, 0.1], (200, 2)))["uwb_bias_m"]
        lows.append(interval_of(bias)[0])
    assert 0.02 < np.mean(np.array(lows) > 0) < 0.08


def assert_same_poses(ours, theirs):
    np.testing.assert_allclose(ours.position_m, theirs.positions_xyz, atol=1e-9)
    turned = Rotation.from_quat(ours.quat_xyzw).inv() * Rotation.from_matrix([p[:3, :3] for p in theirs.poses_se3])
    np.testing.assert_allclose(turned.magnitude(), 0, atol=1e-7)


@given(st.integers(0, 10_000), st.booleans())
def test_alignment_and_projection_are_equal_to_evos(seed, flat):
    rng = np.random.default_rng(seed)
    estimate, reference = trajectory(rng, np.arange(50), flat), trajectory(rng, np.arange(50))
    theirs = as_evo(estimate)
    theirs.align(as_evo(reference))
    assert_same_poses(align_rigidly(estimate, reference), theirs)
    theirs = as_evo(reference)
    theirs.project(Plane.XY)
    assert_same_poses(project_to_plane(reference), theirs)


def walk(n: int = 200, noise_m: float = 0.05, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A track with noise, and the truth."""
    phase = np.linspace(0, 4 * np.pi, n)
    truth = np.stack([4 + 3 * np.sin(phase), 3 + 2 * np.cos(phase / 2)], axis=1)
    return truth + noise_m * np.random.default_rng(seed).standard_normal((n, 2)), truth


def moved(points: np.ndarray, turn_rad: float, shift_m) -> np.ndarray:
    turned = Rotation.from_euler("z", turn_rad).apply(np.column_stack([points, np.zeros(len(points))]))[:, :2]
    return turned + np.asarray(shift_m)


@pytest.mark.parametrize(
    ("turn_deg", "shift_m", "warns"),
    [(0, (0.2, 0), False), (0, (0.3, 0), True), (2, (0, 0), False), (8, (0, 0), True), (180, (7, 2), True)],
)
def test_only_what_is_large_and_explains_the_error_is_told(turn_deg, shift_m, warns):
    track, truth = walk()
    # Turned about the middle of the walk, so that the turn alone does not shift it.
    middle = truth.mean(axis=0)
    reference = moved(truth - middle, np.radians(turn_deg), middle + shift_m)
    holes = np.where(np.arange(200)[:, None] % 3 > 0, reference, np.nan)
    seen = np.isfinite(holes[:, 0])
    found, whole = find_frame_offset(track, holes), find_frame_offset(track[seen], reference[seen])
    assert (frame_offset_words(found) is not None) == warns
    assert found.after_m == whole.after_m == pytest.approx(0.07, abs=0.01)
    assert find_frame_offset(track[:9], reference[:9]) is find_frame_offset(track, np.full((200, 2), np.nan)) is None


def test_a_mirrored_reference_is_told_from_a_turned_one_and_from_a_bend():
    track, truth = walk()
    assert "0.07 m mirrored" in mirror_words(track, truth[:, ::-1])
    assert mirror_words(track, moved(truth, 2.0, (5, 5))) is None
    along_m = np.linspace(0, 50, 200)
    bend_m = 0.5 * np.sin(along_m * np.pi / 50)
    assert mirror_words(np.column_stack([along_m, bend_m]), np.column_stack([along_m, -bend_m])) is None
