"""Rotations, poses between poses and lever arms, against scipy and finite differences."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation, Slerp

from quadlog.geometry import (
    base_covariance,
    base_to_tag,
    interpolate_poses,
    rotation_from_quat,
    tag_to_base,
    transform_from_quat,
    transform_from_rpy,
    wrap_angle,
)

numbers = st.floats(-1e3, 1e3).map(lambda x: round(x, 3))


@given(arrays(float, (5, 4), elements=numbers).filter(lambda quat: (np.abs(quat).max(axis=1) > 0).all()))
def test_rotations_of_quaternions_of_any_length(quat):
    np.testing.assert_allclose(rotation_from_quat(quat), Rotation.from_quat(quat).as_matrix(), atol=1e-14)
    np.testing.assert_array_equal(transform_from_quat(np.ones(3), quat[0])[:3, :3], rotation_from_quat(quat[0]))


@given(st.tuples(*[st.floats(-7, 7)] * 3))
def test_roll_pitch_and_yaw_turn_in_this_order(rpy):
    got = transform_from_rpy(np.array([1.0, 2.0, 3.0]), *rpy)
    np.testing.assert_allclose(got[:3, :3], Rotation.from_euler("ZYX", rpy[::-1]).as_matrix(), atol=1e-14)
    np.testing.assert_array_equal(got[:, 3], [1, 2, 3, 1])


def test_a_replay_does_not_wait_for_scipy_spatial():
    code = "import sys, quadlog.pipelines.executor.compilation; sys.exit('scipy.spatial' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


SECOND = 1_000_000_000


def seconds(*values: float) -> np.ndarray:
    return 1_700_000_000 * SECOND + np.rint(np.array(values) * SECOND).astype(np.int64)


def test_between_poses_is_linear_and_turns_the_short_way_like_slerp():
    known, wanted = seconds(0, 1, 2), seconds(0.25, 1.5, 2)
    yaw = np.array([3.0, -3.0, 0.0])
    xy, got, valid = interpolate_poses(wanted, known, np.array([[0.0, 0.0], [4.0, 8.0], [4.0, 0.0]]), yaw, 1.0)
    assert valid.all()
    np.testing.assert_allclose(xy, [[1.0, 2.0], [4.0, 4.0], [4.0, 0.0]])
    slerp = Slerp([0, 1, 2], Rotation.from_euler("z", yaw[:, None]))([0.25, 1.5, 2]).as_euler("ZYX")[:, 0]
    np.testing.assert_allclose(wrap_angle(got - slerp), 0, atol=1e-12)


@given(st.lists(st.integers(0, 50), max_size=20, unique=True), st.lists(st.integers(-20, 70), max_size=20))
def test_both_neighbours_must_be_near_and_ends_are_held_as_long(known, wanted):
    """Of no poses, too."""
    known_ns, wanted_ns = np.array(sorted(known), np.int64), np.array(wanted, np.int64)
    places_m = np.column_stack([known_ns, -2.0 * known_ns])
    xy_m, yaw_rad, valid = interpolate_poses(wanted_ns, known_ns, places_m, np.zeros(len(known)), 7e-9)
    for t, (x_m, y_m), yaw, is_valid in zip(wanted, xy_m, yaw_rad, valid, strict=True):
        before = [k for k in sorted(known) if k <= t] or sorted(known)[:1]
        after = [k for k in sorted(known) if k >= t] or sorted(known)[-1:]
        assert is_valid == (bool(known) and abs(t - before[-1]) <= 7 and abs(after[0] - t) <= 7)
        held = min(max(t, min(known)), max(known)) if is_valid else np.nan
        np.testing.assert_allclose([x_m, y_m, yaw], [held, -2 * held, 0 * held])


def test_tag_is_where_a_rigid_transform_puts_it_and_back_again():
    rng = np.random.default_rng(0)
    base_m, yaw_rad = rng.uniform(-5, 5, (20, 2)), rng.uniform(-4, 4, 20)
    tag_m = base_to_tag(base_m, yaw_rad, -0.07, 0.14)
    rigid = base_m + Rotation.from_euler("z", yaw_rad[:, None]).apply([-0.07, 0.14, 0.0])[:, :2]
    np.testing.assert_allclose(tag_m, rigid)
    np.testing.assert_allclose(tag_to_base(tag_m, yaw_rad, -0.07, 0.14), base_m)


def test_covariance_from_yaw_against_finite_differences():
    rng = np.random.default_rng(1)
    yaw_rad, std_rad, tag_m = rng.uniform(-4, 4, 20), rng.uniform(0, 0.3, 20), rng.uniform(-5, 5, (20, 2))
    ahead, behind = (tag_to_base(tag_m, yaw_rad + step, 0.3, -0.2) for step in (1e-6, -1e-6))
    slope = (ahead - behind) / 2e-6
    wanted = std_rad[:, None, None] ** 2 * slope[:, :, None] * slope[:, None, :]
    np.testing.assert_allclose(base_covariance(np.zeros((20, 2, 2)), yaw_rad, std_rad, 0.3, -0.2), wanted, atol=1e-9)
