from __future__ import annotations

import numpy as np
import pytest
from evo.core.trajectory import Plane, PosePath3D
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.metrics.alignment import align_rigidly, are_on_line, project_to_plane
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


@pytest.mark.parametrize("n", [1, 2, 20])
def test_poses_on_a_line_cannot_be_aligned(n):
    line = Trajectory(np.arange(n), np.outer(np.arange(n), [1.0, 2, 3]), trajectory(0, n).quat_xyzw)
    assert are_on_line(line, line)
    assert not are_on_line(trajectory(0), trajectory(1))
