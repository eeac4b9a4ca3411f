"""Tracks and fixes of single tags from ranges alone, smoothed and as they were known then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadlog.messages import Float, RangeSeries
from quadlog.positioning.locate import Anchors, LocateSettings, TagInfo, TagResult, locate

HALL_M = np.array([(0.0, 0.0, 1.2), (40.0, 0.0, 1.2), (40.0, 35.0, 1.2), (0.0, 35.0, 1.2)])
HEIGHTS_M = np.array([[0.0, 0.0, 0.3], [8.0, 0.0, 2.6], [8.0, 7.0, 0.4], [0.0, 7.0, 2.5], [4.0, -1.0, 1.5]])
TAG = TagInfo(0, 0.6)


def run(lab, series: RangeSeries, anchors_m: Float, **settings) -> TagResult:
    return lab.locate_tag(series, anchors_m, **({"calibrate": False} | settings))


def anchors(position_m: Float, known_bias_m: float = 0.0) -> Anchors:
    return Anchors(np.arange(len(position_m)), position_m, np.full(len(position_m), known_bias_m))


def errors(simulated, got: TagResult) -> Float:
    return got.track.position_m - simulated.truth_at(got.track.t_ns)


@pytest.mark.parametrize(("smooth", "rate_hz"), [(True, 50), (False, 10)])
def test_weights_point_at_the_late_ranges(lab, smooth, rate_hz):
    simulated = lab.simulate(lab.walk_straight, lab.SQUARE_M, 5, rate_hz=rate_hz)
    since_s = (simulated.series.t_ns - simulated.t_ns[0]) * 1e-9
    late = (simulated.series.anchor == 2) & (since_s > 4) & (since_s < 4.7)
    simulated.series.range_m[late] += 1.0
    got = run(lab, simulated.series, lab.SQUARE_M, smooth=smooth).ranges
    assert got.weight[late].max() < 0.3
    assert np.median(got.weight[~late]) > 0.8
    assert (got.range_m - got.predicted_m)[late].mean() == pytest.approx(1.0, abs=0.25)


def walk_as_assumed(seed: int):
    """White acceleration of the density that is assumed."""

    def walk(t_s):
        rng, step_s = np.random.default_rng([99, seed]), t_s[1] - t_s[0]
        noise = 0.1 * np.array([[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]])
        kick = rng.standard_normal((len(t_s), 2, 2)) @ np.linalg.cholesky(noise).T
        velocity = rng.normal(0, 0.3, 2) + np.cumsum(kick[:, :, 1], axis=0)
        return np.array([4.0, 2.8]) + np.cumsum(velocity * step_s + kick[:, :, 0], axis=0)

    return walk


@pytest.mark.parametrize(("smooth", "seeds"), [(True, 12), (False, 4)])
def test_ellipses_hold_what_they_say_under_white_noise(lab, smooth, seeds):
    """More than 95 %: stamps may be off as well, which these are not."""
    inside = []
    for seed in range(seeds):
        simulated = lab.simulate(walk_as_assumed(seed), lab.SQUARE_M, seed, rate_hz=20)
        got = run(lab, simulated.series, lab.SQUARE_M, smooth=smooth)
        inside.append(lab.share_in_ellipses(errors(simulated, got)[20:], got.track.covariance_m2[20:]))
    assert 0.94 < np.mean(inside) <= 1.0


@pytest.mark.parametrize(("smooth", "low"), [(True, 0.75), (False, 0.4)])
@pytest.mark.parametrize("ratio", [0.5, 1.0, 1.5])
def test_residuals_show_how_far_ranges_err(lab, smooth, low, ratio):
    """One per range on average under the noise that is assumed, the square of the ratio where it is another."""
    simulated = lab.simulate(walk_as_assumed(3), lab.SQUARE_M, 3, duration_s=20, rate_hz=10, std_m=0.1 * ratio)
    got = run(lab, simulated.series, lab.SQUARE_M, smooth=smooth, range_std_m=0.1)
    assert set(got.n_ranges.tolist()) == {4}
    assert low < got.nis.mean() / ratio**2 < 1.4


@pytest.mark.parametrize("std_m", [0.04, 0.15])
def test_the_noise_of_links_is_found_also_where_they_are_blocked(lab, std_m):
    """One link is four times as noisy as the others, a tenth of all ranges are late by 0.5 m on average."""
    simulated = lab.simulate(lab.walk_figure_eight, HEIGHTS_M, 4, duration_s=30, rate_hz=40, std_m=std_m, bursts=True)
    ranges = simulated.series
    noisy = ranges.anchor == 3
    ranges.range_m[noisy] += np.random.default_rng(1).normal(0, 3.9 * std_m, np.count_nonzero(noisy))
    got = run(lab, ranges, HEIGHTS_M)
    np.testing.assert_allclose(got.range_std_m[[0, 1, 2, 4]], std_m, rtol=0.25)
    assert got.range_std_m[3] == pytest.approx(min(4 * std_m / 1.5, 0.3), rel=0.2)


def test_ellipses_of_a_robot_that_stands_among_reflections_hold(lab):
    """Errors that depend on the place do not average out while it stands: 25 s after 20 s of walking."""
    shares = []
    for seed in range(8, 14):
        simulated = lab.simulate(
            lambda t_s: lab.walk_figure_eight(t_s.clip(max=20.0)), lab.SQUARE_M, seed,
            duration_s=45, rate_hz=10, std_m=0.05, bias_m=0.2, place_m=0.06,
        )  # fmt: skip
        got = run(lab, simulated.series, lab.SQUARE_M, calibrate=True)
        stands = got.track.t_ns > simulated.t_ns[0] + 20e9
        shares.append(lab.share_in_ellipses(errors(simulated, got)[stands], got.track.covariance_m2[stands]))
    assert min(shares) > 0.8


@pytest.mark.parametrize(
    ("delay_m", "smooth", "limit_m"), [(0.15, True, 0.045), (0.5, True, 0.045), (0.5, False, 0.09)]
)
def test_paths_that_are_blocked_half_the_time_move_neither_biases_nor_tracks(lab, delay_m, smooth, limit_m):
    """Four of five links: where more ranges are late than not, their median is; delays last for 0.6 s."""
    simulated = lab.simulate(lab.walk_figure_eight, HEIGHTS_M, 4, duration_s=40, rate_hz=20, std_m=0.08, bias_m=0.2)
    rng, range_m = np.random.default_rng(5), simulated.series.range_m.reshape(-1, 5)
    delays_m = rng.exponential(delay_m, (67, 5)) * (rng.random((67, 5)) < [0.55, 0.5, 0.5, 0.55, 0.0])
    range_m += np.repeat(delays_m, 12, axis=0)[: len(range_m)]
    got = run(lab, simulated.series, HEIGHTS_M, calibrate=True, height="given", smooth=smooth)
    error_m = errors(simulated, got)
    assert lab.rmse(error_m[0 if smooth else len(error_m) // 4 :]) < limit_m
    np.testing.assert_allclose(got.bias.bias_m, 0.2, atol=0.045)


def test_neither_the_frame_nor_the_order_of_anchors_nor_other_tags_matter(lab):
    """Ranges do not know where map's axes lie."""
    simulated = lab.simulate(lab.walk_figure_eight, HEIGHTS_M, 8, rate_hz=20, bursts=True)
    turn, order = np.array([[np.cos(2.0), -np.sin(2.0)], [np.sin(2.0), np.cos(2.0)]]), np.array([3, 1, 4, 0, 2])
    turned_m = np.column_stack([HEIGHTS_M[:, :2] @ turn.T + [30.0, -7.0], HEIGHTS_M[:, 2]])
    here, there = (run(lab, simulated.series, each, height="solved").track for each in (HEIGHTS_M, turned_m))
    np.testing.assert_allclose(there.position_m, here.position_m @ turn.T + [30.0, -7.0], atol=2e-3)
    np.testing.assert_allclose(there.covariance_m2, turn @ here.covariance_m2 @ turn.T, rtol=3e-2, atol=1e-6)
    np.testing.assert_allclose(there.z_m, here.z_m, atol=2e-3)
    two = RangeSeries(*(np.repeat(getattr(simulated.series, name), 2) for name in ("t_ns", "tag", "anchor", "range_m")))
    two.tag[1::2], two.range_m[1::2] = 9, 5.0
    mixed = Anchors(order, HEIGHTS_M[order], np.zeros(5))
    first, _ = locate(two, mixed, [TAG, TagInfo(9, 0.6)], LocateSettings(calibrate=False, height="solved")).tags
    np.testing.assert_allclose(first.track.position_m, here.position_m, atol=0.02)


@pytest.mark.parametrize(("smooth", "rate_hz"), [(True, 50), (False, 10)])
def test_the_height_is_found_where_the_geometry_shows_it(lab, smooth, rate_hz):
    """The tag is 0.4 m lower than configured, and nobody says whether to solve for it."""
    simulated = lab.simulate(lab.walk_figure_eight, HEIGHTS_M, 10, duration_s=20, rate_hz=rate_hz)
    given, solved = (
        run(lab, simulated.series, HEIGHTS_M, height_m=1.0, smooth=smooth, height=height).track
        for height in ("given", "auto")
    )
    np.testing.assert_array_equal(given.z_m, 1.0)
    np.testing.assert_array_equal(given.z_std_m, 0.0)
    later = solved.t_ns > solved.t_ns[0] + 2e9
    assert np.abs(solved.z_m[later] - 0.6).mean() < 0.1
    assert (np.abs(solved.z_m - 0.6)[later] < 3 * solved.z_std_m[later]).mean() > 0.97
    off_m = [lab.rmse(each.position_m[later] - simulated.truth_at(each.t_ns[later])) for each in (solved, given)]
    assert off_m[0] < 0.7 * off_m[1]


def walk_and_jump(far_m: float):
    """0.5 m/s, but carried far_m away after 8 s."""
    return lambda t_s: (
        np.array([10.0, 10.0]) + np.array([0.4, 0.3]) * t_s[:, None] + np.where(t_s[:, None] > 8, [far_m, 0.0], 0.0)
    )


@pytest.mark.parametrize(("far_m", "rate_hz", "smooth"), [(2, 50, True), (8, 4, True), (30, 4, False)])
def test_a_tag_that_is_carried_away_is_followed(lab, far_m, rate_hz, smooth):
    """Smoothed: to the instant. Causal: it is known within two seconds."""
    simulated = lab.simulate(walk_and_jump(far_m), HALL_M, 5, duration_s=16, rate_hz=rate_hz)
    got = run(lab, simulated.series, HALL_M, smooth=smooth)
    assert len(got.restart_ns) == 1
    restart_s = (got.restart_ns[0] - simulated.t_ns[0]) * 1e-9
    assert 8.0 <= restart_s < (8.0 + 1.1 / rate_hz if smooth else 10.0)
    t_s, off_m = (got.track.t_ns - simulated.t_ns[0]) * 1e-9, np.hypot(*errors(simulated, got).T)
    quiet = (t_s < 8) | (t_s >= restart_s) if smooth else (t_s < 8) | (t_s > restart_s + 1)
    assert off_m[quiet & (t_s > 1)].max() < 0.45


@pytest.mark.parametrize(("smooth", "seeds", "limit_m"), [(True, 20, 0.06), (False, 2, 0.2)])
def test_three_anchors_and_one_behind_something_for_a_while_lose_no_tag(lab, smooth, seeds, limit_m):
    """One epoch of three ranges cannot show which is late; time can. A track always comes back."""
    every_m = []
    for seed in range(seeds):
        simulated = lab.simulate(lab.walk_straight, lab.TRIANGLE_M, seed, bursts=True)
        got = run(lab, simulated.series, lab.TRIANGLE_M, smooth=smooth)
        assert len(got.restart_ns) == 0
        assert len(got.track) == len(simulated.t_ns)
        every_m.append(np.hypot(*errors(simulated, got).T))
    assert np.sqrt(np.mean(np.square(every_m))) <= limit_m
    assert np.median(every_m, axis=1).max() < 0.6
    away = np.convolve((np.array(every_m) > 1.0).ravel(), np.ones(50), "valid")  # a second
    assert away.max() < 50


@pytest.mark.parametrize("smooth", [True, False])
def test_a_long_gap_starts_a_new_segment_where_there_is_a_fix(lab, smooth):
    """Silent from 5 to 9 s; then only two anchors until 12 s, and silent again until 15 s; a clock that leaps 1 s."""
    simulated = lab.simulate(lab.walk_straight, lab.SQUARE_M, 6, duration_s=20, rate_hz=20)
    since_s = (simulated.series.t_ns - simulated.t_ns[0]) * 1e-9
    silent = ((since_s > 5) & (since_s < 9)) | ((since_s > 12) & (since_s < 15))
    alone = (since_s >= 9) & (since_s <= 12)
    keep = ~silent & ~(alone & (simulated.series.anchor > 1))
    got = run(lab, simulated.series.rows(keep), lab.SQUARE_M, smooth=smooth)
    np.testing.assert_array_equal(np.isnan(got.ranges.predicted_m), alone[keep])
    np.testing.assert_array_equal(got.ranges.weight == 0, alone[keep])
    assert np.isnan(got.ranges.predicted_m).sum() == np.count_nonzero(alone[keep])
    later = got.track.t_ns > simulated.t_ns[0] + 2e9
    assert lab.rmse(errors(simulated, got)[later]) < (0.07 if smooth else 0.2)
    leap = replace(simulated.series, t_ns=simulated.series.t_ns + 10**9 * (since_s > 10))
    leapt = run(lab, leap, lab.SQUARE_M, smooth=smooth)
    assert len(got.restart_ns) == len(leapt.restart_ns) == 0
    assert np.hypot(*(leapt.track.position_m - simulated.position_m[-len(leapt.track) :]).T)[40:].max() < 0.6


@pytest.mark.parametrize("n_anchors", [4, 6])
@pytest.mark.parametrize("smooth", [True, False])
def test_ellipses_hold_errors_that_depend_on_the_place(lab, n_anchors, smooth):
    """Reflections lengthen ranges by what depends on the place, 0.06 m, beside constant biases: no noise shows that."""
    anchors_m, inside, squares = np.vstack([lab.SQUARE_M, [[4.0, -1.0, 1.2], [4.0, 8.0, 1.2]]])[:n_anchors], [], []
    for seed in range(100, 110 if smooth else 102):
        simulated = lab.simulate(
            lab.walk_figure_eight, anchors_m, seed, duration_s=45, rate_hz=10, std_m=0.05, place_m=0.06,
            bias_m=np.random.default_rng(seed).uniform(0.05, 0.2, n_anchors),
        )  # fmt: skip
        got = run(lab, simulated.series, anchors_m, smooth=smooth, calibrate=True)
        error_m, covariance_m2 = errors(simulated, got), got.track.covariance_m2
        inside.append(lab.share_in_ellipses(error_m, covariance_m2))
        squares += list(np.einsum("ni,nij,nj->n", error_m, np.linalg.inv(covariance_m2), error_m))
    assert 0.6 < np.mean(squares) < 2.6  # of two coordinates; stamps agree here: 0.72 to 1.9
    assert np.mean(inside) > 0.93
    assert np.min(inside) > 0.75


@pytest.mark.parametrize(("cut_s", "calibrate"), [(2.0, False), (7.3, True)])
def test_causal_tracks_and_fixes_do_not_see_the_future(lab, cut_s, calibrate):
    """Biases too are as they were known then: fixes of the first seconds are not corrected by what the rest shows."""
    simulated = lab.simulate(lab.walk_straight, lab.TRIANGLE_M, 5, rate_hz=10, bias_m=0.3, bursts=True)
    begun = simulated.series.rows(simulated.series.t_ns < simulated.t_ns[0] + cut_s * 1e9)
    how = {"calibrate": calibrate, "smooth": False}
    whole, part = (run(lab, each, lab.TRIANGLE_M, **how) for each in (simulated.series, begun))
    np.testing.assert_array_equal(part.track.position_m, whole.track.position_m[: len(part.track)])
    np.testing.assert_allclose(part.fixes.position_m, whole.fixes.position_m[: len(part.fixes.position_m)], atol=1e-9)


def test_a_known_bias_is_taken_out_and_comes_back_in_the_prediction(lab):
    simulated = lab.simulate(lab.walk_straight, lab.SQUARE_M, 1, bias_m=0.4)
    got = locate(simulated.series, anchors(lab.SQUARE_M, 0.4), [TAG], LocateSettings(calibrate=False)).tags[0]
    assert lab.rmse(got.fixes.position_m - simulated.truth_at(got.epochs.t_ns)) < 0.12
    assert np.abs(np.median(got.ranges.range_m - got.ranges.predicted_m)) < 0.03


def test_a_tag_that_appears_half_way_one_that_never_does_and_epochs_without_a_fix_by_cause(lab):
    five_m = np.vstack([lab.SQUARE_M, [[4.0, 0.0, 1.2]]])
    simulated = lab.simulate(lab.walk_straight, five_m, 6)
    range_m = simulated.range_m.copy()
    range_m[410:415, 2:], range_m[420:422, 2:4] = 0.0, np.nan
    late = replace(simulated.series, tag=np.repeat(4 * (np.arange(600) > 300), 5), range_m=range_m.ravel())
    got = locate(late, anchors(five_m), [TagInfo(4, 0.6), TagInfo(5, 0.6)], LocateSettings(epoch_s=0.001))
    assert got.tags[0].track.t_ns[0] == simulated.t_ns[301]
    assert len(got.tags[1].track) == len(got.tags[1].epochs.t_ns) == 0
    assert got.counts.other_tags == ((0, 301 * 5),)
    assert [np.sum(each) for each in (~got.tags[0].fixes.solved, got.tags[0].fixes.degenerate)] == [7, 2]
    assert np.isfinite(got.tags[0].ranges.predicted_m).all()
    assert (got.counts.not_positive, got.counts.not_finite) == (15, 4)
