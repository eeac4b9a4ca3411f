from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from quadlog.geometry import interpolate_poses, wrap_angle

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


def test_both_neighbours_must_be_near_and_ends_are_held_as_long():
    wanted = seconds(-0.6, -0.4, 0, 0.3, 5, 9.7, 10, 10.4, 10.6)
    xy, yaw, valid = interpolate_poses(wanted, seconds(0, 10), np.array([[1.0, 2.0], [3.0, 4.0]]), np.zeros(2), 0.5)
    np.testing.assert_array_equal(valid, [False, True, True, False, False, False, True, True, False])
    np.testing.assert_array_equal(np.isnan(xy).any(axis=1), ~valid)
    np.testing.assert_array_equal(np.isnan(yaw), ~valid)
    np.testing.assert_array_equal(xy[[1, 7]], [[1.0, 2.0], [3.0, 4.0]])


def test_no_poses_and_no_wishes():
    none = np.empty(0, dtype=np.int64)
    assert not interpolate_poses(seconds(1, 2), none, np.empty((0, 2)), np.empty(0), 1.0)[2].any()
    assert interpolate_poses(none, seconds(1), np.zeros((1, 2)), np.zeros(1), 1.0)[0].shape == (0, 2)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.integers(0, 50), min_size=1, max_size=20, unique=True), st.lists(st.integers(-20, 70), max_size=20))
def test_valid_is_what_its_sentence_says(known, wanted):
    known = sorted(known)
    got = interpolate_poses(
        np.array(wanted, dtype=np.int64),
        np.array(known, dtype=np.int64),
        np.zeros((len(known), 2)),
        np.zeros(len(known)),
        7e-9,
    )[2]
    for t, valid in zip(wanted, got, strict=True):
        before = [k for k in known if k <= t] or known[:1]
        after = [k for k in known if k >= t] or known[-1:]
        assert valid == (abs(t - before[-1]) <= 7 and abs(after[0] - t) <= 7)


def test_a_pose_at_the_gap_counts():
    assert interpolate_poses(seconds(0.5), seconds(0, 1), np.zeros((2, 2)), np.zeros(2), 0.5)[2].all()
