from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.control.following.path import nearest_on_path
from quadlog.control.following.pure_pursuit import (
    AHEAD_M,
    BEHIND_M,
    FINISHED_M,
    PathFollower,
    checked_path,
)
from quadlog.simulation.robot.unicycle_robot import unicycle_step

CORNER = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]])
LEGS = np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 0.3], [0.0, 0.3], [0.0, 0.6], [5.0, 0.6]])


def points_at_lengths(path, length_m):
    """The points (N, 2) so far along a path, by interpolation of each coordinate."""
    arc_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    return np.stack([np.interp(length_m, arc_m, path[:, axis]) for axis in (0, 1)], axis=1)


def walk(path, lookahead_m, push=None):
    """Walks a path at 50 Hz: progress and cross-track error (T,) each; push: metres to the left, by tick."""
    follower, rows = PathFollower(path), []
    x, y, yaw = *path[0], math.atan2(*(path[1] - path[0])[::-1])
    for k in range(6000):
        state = follower.step(x, y, yaw)
        if state.finished:
            return np.array(rows).T
        command = follower.pursue(x, y, yaw, state, lookahead_m, 0.5, 1.5)
        rows.append((state.progress_m, state.near.distance_m))
        x, y, yaw = unicycle_step(x, y, yaw, command.v_mps, command.yaw_rate_radps, 0.02)
        y += 0.0 if push is None else push(k)
    raise AssertionError("it never arrived")


def closed_circle(radius_m, points=400):
    angle = np.linspace(0, 2 * np.pi, points)
    return radius_m * np.stack([np.sin(angle), 1 - np.cos(angle)], axis=1)


@given(seed=st.integers(0, 2**32 - 1))
def test_nearest_within_its_window_against_dense_samples(seed):
    rng = np.random.default_rng(seed)
    path = rng.uniform(-2, 2, (6, 2)).repeat(rng.integers(1, 3, 6), axis=0)
    start_m = rng.uniform(0, 8)
    follower = PathFollower(path, start_m)
    at = min(start_m, follower.length_m)
    x, y = rng.uniform(-3, 3, 2)
    state = follower.step(x, y, 0.0)
    low, high = max(at - BEHIND_M, 0), min(at + AHEAD_M, follower.length_m)
    assert low - 1e-9 <= state.progress_m <= high + 1e-9
    samples = points_at_lengths(path, np.linspace(low, high, 1501))
    nearest = np.hypot(*(samples - [x, y]).T).min()
    assert nearest - 2e-3 <= state.error_m <= nearest + 1e-9
    on_path = points_at_lengths(path, np.array([state.progress_m]))[0]
    assert on_path == pytest.approx([state.near.x_m, state.near.y_m], abs=1e-9)
    assert state.progress_m + state.remaining_m == pytest.approx(follower.length_m)


@pytest.mark.parametrize("lookahead_m", [0.5, 1.0, 2.0])
def test_a_closed_circle_is_walked_round_once(lookahead_m):
    path = closed_circle(2.0)
    assert nearest_on_path(path, *path[-2]).segment > 300
    progress_m, cross_track_m = walk(path, lookahead_m)
    assert np.diff(progress_m).max() < 0.05
    assert progress_m[-1] > 2 * math.pi * 2.0 - 0.2
    assert np.abs(cross_track_m).max() < 0.02


def test_parallel_legs_are_walked_one_after_the_other():
    """Pushed from the first onto the second, 0.3 m beside it, the robot returns to the first."""
    progress_m, cross_track_m = walk(LEGS, 0.5, push=lambda k: 0.25 if k == 200 else 0.0)
    assert cross_track_m.max() == pytest.approx(0.25, abs=0.01)
    assert np.diff(progress_m[:450]).max() < 0.05
    assert np.diff(progress_m).max() < AHEAD_M
    assert 1.9 < progress_m[201] < 2.1
    assert len(progress_m) * 0.02 * 0.5 > 14


def test_the_look_ahead_does_not_leave_out_a_turn():
    """On a leg 1 m before its end the first point 2 m away lies on the leg back, behind the robot."""
    path = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 0.1], [0.0, 0.1]])
    follower = PathFollower(path, start_m=9.0)
    state = follower.step(9.0, 0.0, 0.0)
    command = follower.pursue(9.0, 0.0, 0.0, state, 2.0, 0.5, 1.5)
    assert command.lookahead_y_m == pytest.approx(0.1)
    assert command.lookahead_x_m == pytest.approx(10.0 - (math.pi - 1.1))
    # Progress may go as far as the robot was sent, not farther.
    assert follower.step(9.0, 0.1, 0.0).progress_m == pytest.approx(11.1)
    assert PathFollower(path, start_m=9.0).step(9.0, 0.1, 0.0).progress_m == pytest.approx(9.0)


def test_finished_only_at_the_end():
    circle = PathFollower(closed_circle(2.0))
    assert not circle.step(0.0, 0.0, 0.0).finished
    end = PathFollower(CORNER, start_m=7.0)
    assert end.step(4.0, 3.0 - 0.9 * FINISHED_M, 0.0).finished
    assert not end.step(4.0, 3.0 - 1.1 * FINISHED_M, 0.0).finished
    assert not end.step(4.0, 3.0 + 1.1 * FINISHED_M, 0.0).finished


@pytest.mark.parametrize(
    ("points", "reason"),
    [
        ([], "shape"),
        ([(0, 0, 0), (1, 1, 1)], "shape"),
        ([1.0, 2.0], "shape"),
        (None, "shape"),
        ([(0, 0), (1,)], "list of points"),
        ([("a", "b")], "list of points"),
        ([(0, 0), (1, math.nan)], r"point 2 of the path, \(1, nan\), is no place"),
        ([(0, 0), (math.inf, 0)], "no place"),
        ([(0, 0), (4.5e6, 0)], "no place in metres"),
        ([(1, 2)], r"stays at \(1, 2\)"),
        ([(1, 2), (1, 2)], "two different points"),
        ([(0, 0), (1, 0), (1, 0), (31, 40)], r"gap of 50.0 m from \(1, 0\) to \(31, 40\)"),
    ],
)
def test_what_is_no_path_is_refused(points, reason):
    with pytest.raises(ValueError, match=reason):
        checked_path(points)


@given(st.lists(st.tuples(st.floats(), st.floats()), max_size=6))
def test_any_points_are_a_path_that_can_be_followed_or_refused(points):
    try:
        path = checked_path(points)
    except ValueError:
        return
    follower = PathFollower(path)
    state = follower.step(*path[0], 0.0)
    assert np.isfinite(state[1:4]).all()
    assert np.isfinite(follower.pursue(*path[0], 0.0, state, 1.0, 0.5, 1.5)).all()
