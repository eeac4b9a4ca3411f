from __future__ import annotations

import numpy as np
import pytest
from evo.core.trajectory import Plane, PosePath3D
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.metrics.alignment import align_rigidly, aligned_square_m2, project_to_plane
from quadlog.metrics.positioning import Trajectory


def trajectory(seed, n=50, flat=False):
    rng = np.random.default_rng(seed)
    position_m = rng.normal(size=(n, 3)).cumsum(axis=0) * ([1, 1, 0] if flat else [1, 1, 1])
    return Trajectory(np.arange(n), position_m, Rotation.random(n, rng=rng).as_quat())


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


def test_a_moved_trajectory_comes_back():
    reference = trajectory(4)
    turn = Rotation.from_rotvec([0.3, -2, 1])
    moved = Trajectory(
        reference.t_ns,
        turn.apply(reference.position_m) + 5,
        (turn * Rotation.from_quat(reference.quat_xyzw)).as_quat(),
    )
    np.testing.assert_allclose(align_rigidly(moved, reference).position_m, reference.position_m, atol=1e-9)


@pytest.mark.parametrize("n", [1, 2, 20])
def test_poses_on_a_line_cannot_be_aligned(n):
    line = Trajectory(np.arange(n), np.outer(np.arange(n), [1.0, 2, 3]), trajectory(0, n).quat_xyzw)
    assert align_rigidly(line, line) is None


@pytest.mark.filterwarnings("ignore:Optimal rotation is not uniquely")  # on one line, where its residual still is
@given(st.integers(0, 10_000), st.sampled_from([(1, 1, 1), (1, 1, 0), (1, 0, 0)]))
def test_what_alignment_leaves_is_known_beforehand(seed, axes):
    one, other = trajectory(seed).position_m * axes, trajectory(seed + 1).position_m
    one, other = one - one.mean(axis=0), other - other.mean(axis=0)
    _, root_sum_of_squares = Rotation.align_vectors(other, one)
    left_m2 = aligned_square_m2(
        np.array([(one**2).sum() / 50]), np.array([(other**2).sum() / 50]), (one.T @ other / 50)[None]
    )
    np.testing.assert_allclose(left_m2, root_sum_of_squares**2 / 50, rtol=1e-9, atol=1e-9)
