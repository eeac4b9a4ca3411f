from __future__ import annotations

import numpy as np
import pytest
from evo.core.trajectory import Plane, PosePath3D
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.messages import PoseSeries
from quadlog.metrics.alignment import (
    align_rigidly,
    are_on_line,
    find_frame_offset,
    frame_offset_words,
    mirror_words,
    project_to_plane,
)


def trajectory(seed, n=50, flat=False):
    rng = np.random.default_rng(seed)
    position_m = rng.normal(size=(n, 3)).cumsum(axis=0) * ([1, 1, 0] if flat else [1, 1, 1])
    return PoseSeries(np.arange(n), position_m, Rotation.random(n, rng=rng).as_quat())


def as_evo(ours):
    return PosePath3D(ours.position_m, np.roll(ours.quat_xyzw, 1, axis=1))


def assert_same_poses(ours, theirs):
    np.testing.assert_allclose(ours.position_m, theirs.positions_xyz, atol=1e-9)
    turned = Rotation.from_quat(ours.quat_xyzw).inv() * Rotation.from_matrix([p[:3, :3] for p in theirs.poses_se3])
    np.testing.assert_allclose(turned.magnitude(), 0, atol=1e-7)


@pytest.mark.parametrize("flat", [False, True])
@given(st.integers(0, 10_000))
def test_equal_to_evos_alignment(flat, seed):
    estimate, reference = trajectory(seed, flat=flat), trajectory(seed + 1)
    theirs = as_evo(estimate)
    theirs.align(as_evo(reference))
    assert_same_poses(align_rigidly(estimate, reference), theirs)


@given(st.integers(0, 10_000))
def test_equal_to_evos_projection(seed):
    ours, theirs = trajectory(seed), as_evo(trajectory(seed))
    theirs.project(Plane.XY)
    assert_same_poses(project_to_plane(ours), theirs)


@pytest.mark.parametrize("n", [1, 2, 20])
def test_poses_on_a_line_cannot_be_aligned(n):
    line = PoseSeries(np.arange(n), np.outer(np.arange(n), [1.0, 2, 3]), trajectory(0, n).quat_xyzw)
    assert are_on_line(line, line)
    assert not are_on_line(trajectory(0), trajectory(1))


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
    [(0, (0.2, 0), False), (0, (0.4, 0), True), (2, (0, 0), False), (8, (0, 0), True), (180, (7, 2), True)],
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
