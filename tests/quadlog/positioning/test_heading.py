from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from scipy.stats import circmean

from quadlog.geometry import wrap_angle
from quadlog.positioning.heading import align_yaw, align_yaw_causally, course_heading
from quadlog.positioning.tracker import Track


def track(velocity_mps, period_s: float = 0.1) -> Track:
    velocity_mps = np.asarray(velocity_mps, dtype=np.float64)
    n = len(velocity_mps)
    t_ns = 5_000_000_000 + np.rint(np.arange(n) * period_s * 1e9).astype(np.int64)
    position_m = np.cumsum(velocity_mps, axis=0) * period_s
    covariance = np.tile(0.01 * np.eye(2), (n, 1, 1))
    return Track(t_ns, position_m, velocity_mps, covariance, covariance, np.full(n, 0.6), np.zeros(n))


def curved(n: int = 600, noise_mps: float = 0.0, seed: int = 0) -> tuple[Track, np.ndarray]:
    """A walk at 0.5 m/s that turns to and fro past +-180 degrees, and its true yaw."""
    yaw = np.pi + 1.5 * np.sin(np.arange(n) / 40)
    velocity = 0.5 * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    return track(velocity + noise_mps * np.random.default_rng(seed).standard_normal((n, 2))), wrap_angle(yaw)


def test_course_is_held_while_slow_and_begins_with_the_first_course():
    got = course_heading(track([[0, 0], [0.1, 0], [0, 0.3], [0.0, -0.19], [-0.3, 0], [0, 0]]))
    np.testing.assert_allclose(got, wrap_angle(np.array([90, 90, 90, 90, 180, 180]) * np.pi / 180))


def test_a_causal_course_does_not_know_the_first_motion_beforehand():
    got = course_heading(track([[0, 0], [0, 0.3]]), before_motion_rad=0.5)
    np.testing.assert_allclose(got, [0.5, np.pi / 2])


def test_a_tag_that_never_moves_looks_along_x():
    np.testing.assert_array_equal(course_heading(track(np.zeros((3, 2)))), 0)
    assert course_heading(track(np.empty((0, 2)))).shape == (0,)


def test_a_causal_offset_is_found_and_knows_nothing_of_what_comes():
    walked, yaw = curved(noise_mps=0.1)
    sensor = wrap_angle(yaw - 2.0)
    whole = align_yaw_causally(walked, walked.t_ns, sensor)
    np.testing.assert_allclose(wrap_angle(whole[-100:] - yaw[-100:]), 0, atol=0.03)
    half = Track(*(getattr(walked, each.name)[:300] for each in fields(walked)))
    np.testing.assert_array_equal(align_yaw_causally(half, walked.t_ns[:300], sensor[:300]), whole[:300])
    still = track(np.zeros((5, 2)))
    np.testing.assert_allclose(align_yaw_causally(still, still.t_ns, np.full(5, 0.3)), 0.3)


@pytest.mark.parametrize("offset", [0.0, 1.0, 3.1, -2.5])
def test_offset_is_found_whatever_it_is(offset):
    walked, yaw = curved()
    got = align_yaw(walked, walked.t_ns, wrap_angle(yaw - offset))
    assert wrap_angle(np.array(got.offset_rad - offset)) == pytest.approx(0, abs=1e-6)
    np.testing.assert_allclose(wrap_angle(got.yaw_rad - yaw), 0, atol=1e-6)
    assert got.moving_s == 60


def test_offset_of_noisy_courses_is_near_their_circular_mean():
    walked, yaw = curved(noise_mps=0.05)
    course = np.arctan2(walked.velocity_mps[:, 1], walked.velocity_mps[:, 0])
    got = align_yaw(walked, walked.t_ns, yaw - 0.7)
    assert got.offset_rad == pytest.approx(circmean(course - yaw + 0.7), abs=0.01)


def test_std_is_the_scatter_over_many_walks():
    found = []
    for seed in range(60):
        walked, yaw = curved(noise_mps=0.1, seed=seed)
        found.append(align_yaw(walked, walked.t_ns, yaw))
    scatter = np.std([each.offset_rad for each in found])
    assert np.mean([each.std_rad for each in found]) == pytest.approx(scatter, rel=0.35)


def test_a_third_of_walking_backwards_does_not_turn_the_heading():
    walked, yaw = curved()
    velocity = walked.velocity_mps.copy()
    velocity[100:300] *= -1
    got = align_yaw(track(velocity), walked.t_ns, yaw - 1.0)
    assert got.offset_rad == pytest.approx(1.0, abs=0.02)


def test_without_motion_or_without_yaw_the_std_is_infinite():
    still = track(np.zeros((5, 2)))
    got = align_yaw(still, still.t_ns, np.full(5, 0.3))
    np.testing.assert_allclose(got.yaw_rad, 0.3)
    assert (got.offset_rad, got.std_rad, got.moving_s) == (0.0, np.inf, 0.0)
    assert align_yaw(still, np.empty(0, dtype=np.int64), np.empty(0)).std_rad == np.inf


def test_yaw_that_covers_part_of_the_walk_is_aligned_on_that_part():
    walked, yaw = curved()
    part = slice(200, 400)
    got = align_yaw(walked, walked.t_ns[part], yaw[part] - 2.0)
    assert got.offset_rad == pytest.approx(2.0, abs=1e-6)
    assert got.moving_s <= 21


def test_a_tag_in_front_swings_out_in_turns_and_that_is_no_heading():
    """A circle to the left all the way: the tag's course leads the yaw by a constant angle, which is not an offset."""
    t_s = np.arange(400) * 0.1
    yaw = 0.5 * t_s
    position_m = np.stack([np.sin(yaw), 1 - np.cos(yaw)], axis=1) + 0.3 * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    walked = track(np.gradient(position_m, t_s, axis=0))
    sensor = wrap_angle(yaw - 1.0)
    assert align_yaw(walked, walked.t_ns, sensor, 0.3).offset_rad == pytest.approx(1.0, abs=0.01)
    assert align_yaw(walked, walked.t_ns, sensor).offset_rad == pytest.approx(1.0 + np.arctan2(0.15, 0.5), abs=0.01)
