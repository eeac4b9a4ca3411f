from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadlog.messages import Float
from quadlog.positioning.track.tracker import PositionSpread, TrackedRanges, track_ranges


def track(lab, simulated, anchors_m: Float, *, smooth: bool, keep=slice(None), **more) -> TrackedRanges:
    """Started at the truth, so that only tracking is tested; the start is a fix known at once."""
    rows = simulated.series
    return track_ranges(
        rows.t_ns[keep],
        rows.anchor[keep],
        rows.range_m[keep],
        anchors_m,
        lab.TAG_HEIGHT_M,
        simulated.t_ns,
        simulated.position_m,
        range_std_m=0.1,
        acceleration_std_mps2=1.0,
        smooth=smooth,
        **more,
    )


def errors(lab, tracked: TrackedRanges, simulated) -> float:
    return lab.rmse(tracked.track.position_m - simulated.truth_at(tracked.track.t_ns))


def test_clean_ranges_are_smoothed_far_below_their_noise(lab):
    simulated = lab.simulate(lab.walk_straight, lab.TRIANGLE_M, 1)
    assert errors(lab, track(lab, simulated, lab.TRIANGLE_M, smooth=False), simulated) < 0.08
    tracked = track(lab, simulated, lab.TRIANGLE_M, smooth=True)
    assert errors(lab, tracked, simulated) < 0.05
    np.testing.assert_allclose(tracked.track.velocity_mps[100:-100].mean(axis=0), [0.4, 0.3], atol=0.02)


def test_weights_point_at_the_late_ranges(lab):
    simulated = lab.simulate(lab.walk_straight, lab.SQUARE_M, 5)
    late = (simulated.series.anchor == 2) & (simulated.series.t_ns > simulated.t_ns[200])
    late &= simulated.series.t_ns < simulated.t_ns[230]
    simulated.series.range_m[late] += 1.0
    for smooth in (False, True):
        tracked = track(lab, simulated, lab.SQUARE_M, smooth=smooth)
        assert tracked.weight[late].max() < 0.2
        assert np.median(tracked.weight[~late]) > 0.8
        residual_m = simulated.series.range_m - tracked.predicted_m
        assert residual_m[late].mean() == pytest.approx(1.0, abs=0.15)


def test_a_long_gap_starts_a_new_track_at_the_next_fix(lab):
    simulated = lab.simulate(lab.walk_straight, lab.SQUARE_M, 6, duration_s=20)
    seconds = (simulated.series.t_ns - simulated.t_ns[0]) * 1e-9
    keep = np.flatnonzero((seconds < 5) | (seconds > 9))
    known = (simulated.t_ns - simulated.t_ns[0]) * 1e-9
    fixes = np.flatnonzero((known < 1) | (known > 9.5))
    rows = simulated.series
    tracked = track_ranges(
        rows.t_ns[keep], rows.anchor[keep], rows.range_m[keep], lab.SQUARE_M, lab.TAG_HEIGHT_M,
        simulated.t_ns[fixes], simulated.position_m[fixes], range_std_m=0.1, acceleration_std_mps2=1.0, smooth=True,
    )  # fmt: skip
    between = (seconds[keep] > 5) & (seconds[keep] < 9.51)
    np.testing.assert_array_equal(np.isnan(tracked.predicted_m), between)
    np.testing.assert_array_equal(tracked.weight == 0, between)
    after = tracked.track.t_ns - simulated.t_ns[0] > 9e9
    assert (tracked.track.t_ns[after][0] - simulated.t_ns[0]) * 1e-9 == pytest.approx(9.52, abs=0.02)
    assert errors(lab, tracked, simulated) < 0.06


def walk_as_assumed(seed: int):
    """White acceleration of the density that the tracker assumes."""

    def walk(t_s):
        rng, step_s = np.random.default_rng([99, seed]), t_s[1] - t_s[0]
        noise = 0.1 * np.array([[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]])
        kick = rng.standard_normal((len(t_s), 2, 2)) @ np.linalg.cholesky(noise).T
        velocity = rng.normal(0, 0.3, 2) + np.cumsum(kick[:, :, 1], axis=0)
        return np.array([4.0, 2.8]) + np.cumsum(velocity * step_s + kick[:, :, 0], axis=0)

    return walk


def normalised_errors(simulated, tracked: TrackedRanges) -> Float:
    got = tracked.track
    error_m = got.position_m - simulated.truth_at(got.t_ns)
    return np.einsum("ti,ti->t", error_m, np.linalg.solve(got.covariance_m2, error_m[:, :, None])[:, :, 0])


@pytest.mark.parametrize("smooth", [False, True])
def test_ellipses_hold_what_they_say_under_white_noise(lab, smooth):
    """Somewhat more than 95 %: stamps may be off as well, which these are not."""
    inside = []
    for seed in range(20):
        simulated = lab.simulate(walk_as_assumed(seed), lab.SQUARE_M, seed, rate_hz=25)
        tracked = track(lab, simulated, lab.SQUARE_M, smooth=smooth)
        inside.append(normalised_errors(simulated, tracked)[25:] < 5.991)
    assert 0.95 < np.mean(inside) < 0.995


def test_innovations_show_how_far_ranges_err(lab):
    """One per range on average under the noise that is assumed, the square of the ratio where it is another."""
    for std_m, low, high in ((0.05, 0.2, 0.3), (0.1, 0.75, 1.1), (0.15, 1.4, 2.4)):
        simulated = lab.simulate(walk_as_assumed(3), lab.SQUARE_M, 3, duration_s=40, rate_hz=25, std_m=std_m)
        tracked = track(lab, simulated, lab.SQUARE_M, smooth=True)
        np.testing.assert_array_equal(tracked.n_ranges, 4)
        assert low < tracked.nis.mean() < high


@pytest.mark.parametrize("smooth", [False, True])
def test_a_spread_raises_the_ellipses_to_it_on_average(lab, smooth):
    simulated = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, 4, rate_hz=25)
    plain = track(lab, simulated, lab.SQUARE_M, smooth=smooth).track
    spread = PositionSpread(model_m2=0.01, lasting_m2=0.04)
    raised = track(lab, simulated, lab.SQUARE_M, smooth=smooth, spread=spread).track
    added_m2 = np.trace(raised.covariance_m2 - plain.covariance_m2, axis1=1, axis2=2).mean()
    own_m2 = (np.trace(plain.covariance_m2, axis1=1, axis2=2) / plain.position_excess).mean()
    assert added_m2 == pytest.approx(0.04 + (max(0.01, own_m2) - own_m2 if smooth else 0.0))
    np.testing.assert_array_equal(raised.position_m, plain.position_m)
    np.testing.assert_array_equal(raised.velocity_covariance_m2ps2, plain.velocity_covariance_m2ps2)


def test_a_turned_and_shifted_world_gives_the_turned_and_shifted_track(lab):
    """Ranges do not know where map's axes lie."""
    simulated = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, 8, bursts=True)
    turn = np.array([[np.cos(2.0), -np.sin(2.0)], [np.sin(2.0), np.cos(2.0)]])
    anchors_m = np.column_stack([lab.SQUARE_M[:, :2] @ turn.T + [30.0, -7.0], lab.SQUARE_M[:, 2]])
    here = track(lab, simulated, lab.SQUARE_M, smooth=True, tag_height_std_m=0.2).track
    moved = replace(simulated, position_m=simulated.position_m @ turn.T + [30.0, -7.0])
    there = track(lab, moved, anchors_m, smooth=True, tag_height_std_m=0.2).track
    np.testing.assert_allclose(there.position_m, here.position_m @ turn.T + [30.0, -7.0], atol=1e-4)
    np.testing.assert_allclose(there.velocity_mps, here.velocity_mps @ turn.T, atol=1e-3)
    np.testing.assert_allclose(there.covariance_m2, turn @ here.covariance_m2 @ turn.T, rtol=1e-2, atol=1e-7)
    np.testing.assert_allclose(there.z_m, here.z_m, atol=1e-4)


HEIGHTS_M = np.array([[0.0, 0.0, 0.3], [8.0, 0.0, 2.6], [8.0, 7.0, 0.4], [0.0, 7.0, 2.5]])


@pytest.mark.parametrize("smooth", [False, True])
def test_the_height_is_found_where_the_geometry_tells_it(lab, smooth):
    """The tag is 0.4 m lower than told; ranges are those of 0.6 m."""
    simulated = lab.simulate(lab.walk_figure_eight, HEIGHTS_M, 10, duration_s=20)
    rows = simulated.series
    fixes_m = simulated.position_m
    known, tracked = (
        track_ranges(
            rows.t_ns, rows.anchor, rows.range_m, HEIGHTS_M, 1.0, simulated.t_ns, fixes_m, range_std_m=0.1,
            acceleration_std_mps2=1.0, smooth=smooth, tag_height_std_m=std_m,
        ).track
        for std_m in (0.0, 0.5)
    )  # fmt: skip
    np.testing.assert_array_equal(known.z_m, 1.0)
    np.testing.assert_array_equal(known.z_std_m, 0.0)
    assert np.abs(tracked.z_m[100:] - 0.6).mean() < 0.06
    assert (np.abs(tracked.z_m - 0.6)[100:] < 3 * tracked.z_std_m[100:]).mean() > 0.97
    assert tracked.z_std_m[100:].max() < 0.15
    assert lab.rmse(tracked.position_m - simulated.position_m) < 0.6 * lab.rmse(known.position_m - simulated.position_m)


def test_a_height_the_anchors_cannot_see_stays_as_it_was_told(lab):
    """Anchors level with the tag: neither a drift, nor a std below or above what was told."""
    level_m = lab.SQUARE_M * [1.0, 1.0, 0.0] + [0.0, 0.0, lab.TAG_HEIGHT_M]
    simulated = lab.simulate(lab.walk_straight, level_m, 11, duration_s=60, rate_hz=10)
    got = track(lab, simulated, level_m, smooth=True, tag_height_std_m=0.1).track
    np.testing.assert_allclose(got.z_m, lab.TAG_HEIGHT_M, atol=0.05)
    assert got.z_std_m.min() > 0.03
    assert got.z_std_m.max() <= 0.13


def test_a_link_that_is_always_late_is_trusted_where_that_is_usual(lab):
    """0.4 m on one link of four: late while nothing is known of it; the track is that of the ranges as they are."""
    simulated = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, 12, duration_s=20, rate_hz=25)
    own = simulated.series.anchor == 2
    simulated.series.range_m[own] += 0.4
    doubted = track(lab, simulated, lab.SQUARE_M, smooth=True)
    usual_m = np.array([0.0, 0.0, 0.4, 0.0])
    usual = track(lab, simulated, lab.SQUARE_M, smooth=True, usual_m=usual_m)
    assert np.median(doubted.weight[own]) < 0.5
    assert np.median(usual.weight[own]) > 0.9
    pulled_m = usual.track.position_m - simulated.truth_at(usual.track.t_ns)
    away = usual.track.position_m - lab.SQUARE_M[2, :2]
    assert 0.1 < np.mean((pulled_m * away).sum(axis=1) / np.hypot(*away.T)) < 0.35
