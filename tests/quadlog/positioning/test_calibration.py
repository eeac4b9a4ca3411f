"""Biases found without truth, whether they are applied, and what that does to the track of a tag."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from quadlog.messages import Float, RangeSeries
from quadlog.positioning.anchor_bias import COMMON_STD_M, LINK_STD_M, Calibration, calibrate_links
from quadlog.positioning.locate import Anchors, LocateSettings, TagInfo, TagResult, locate

BIAS_M = np.array([0.25, 0.0, 0.1, 0.18])


def estimate(
    lab, simulated, anchors_m: Float, keep=slice(None), height_m: float | None = None, height_std_m: float = 0.0
) -> Calibration:
    """Started at the truth."""
    rows = simulated.series
    heard = np.flatnonzero(np.isfinite(rows.range_m))[keep]
    return calibrate_links(
        rows.t_ns[heard], rows.anchor[heard], rows.range_m[heard], anchors_m,
        lab.TAG_HEIGHT_M if height_m is None else height_m, simulated.t_ns, simulated.position_m,
        range_std_m=0.1, acceleration_std_mps2=1.0, tag_height_std_m=height_std_m,
    )  # fmt: skip


def round_robin(lab, seed: int, *, period_s=0.125, duration_s=60.0, std_m=0.05, bias_m=BIAS_M / 5) -> tuple:
    """A figure of eight heard by one anchor at a time, four in each period; and the truth at each of them."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, duration_s, period_s / 4)
    anchor = np.arange(len(t_s)) % 4
    place_m = lab.walk_figure_eight(t_s)
    range_m = lab.true_ranges(place_m, lab.SQUARE_M)[np.arange(len(t_s)), anchor]
    range_m = range_m + bias_m[anchor] + std_m * rng.standard_normal(len(t_s))
    t_ns = 1_700_000_000_000_000_000 + np.rint(t_s * 1e9).astype(np.int64)
    return RangeSeries(t_ns, np.zeros(len(t_s), dtype=np.int64), anchor, range_m), place_m


def run(lab, series: RangeSeries, **settings) -> TagResult:
    anchors = Anchors(np.arange(4), lab.SQUARE_M, np.zeros(4))
    return locate(series, anchors, [TagInfo(0, lab.TAG_HEIGHT_M)], LocateSettings(**settings)).tags[0]


def track_error(lab, got: TagResult, series: RangeSeries, place_m: Float) -> float:
    """The track starts with the first fix, at the end of a round."""
    return lab.rmse(got.track.position_m - place_m[np.searchsorted(series.t_ns, got.track.t_ns)])


def kalman_filter(lab, series: RangeSeries, start_m: Float) -> Float:
    """A plain causal filter over single ranges, (N, 2): constant velocity, the noise of round_robin known to it."""
    t_s = (series.t_ns - series.t_ns[0]) * 1e-9
    state, covariance, found = np.array([*start_m, 0.0, 0.0]), np.diag([0.25, 0.25, 1.0, 1.0]), []
    for k, (anchor, range_m) in enumerate(zip(series.anchor, series.range_m, strict=True)):
        step_s = t_s[k] - t_s[k - 1] if k else 0.0
        move = np.eye(4) + step_s * np.eye(4, k=2)
        shaken = np.array([[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]])
        state, covariance = move @ state, move @ covariance @ move.T + 0.5 * np.kron(shaken, np.eye(2))
        offset_m = np.append(state[:2], lab.TAG_HEIGHT_M) - lab.SQUARE_M[anchor]
        distance_m = np.linalg.norm(offset_m)
        towards = np.append(offset_m[:2] / distance_m, [0.0, 0.0])
        gain = covariance @ towards / (towards @ covariance @ towards + 0.05**2)
        state, covariance = state + gain * (range_m - distance_m), covariance - np.outer(gain, towards @ covariance)
        found.append(state[:2])
    return np.array(found)


def test_biases_are_found_without_truth(lab):
    simulated = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, 1, duration_s=60, bias_m=BIAS_M)
    got = estimate(lab, simulated, lab.SQUARE_M).bias
    np.testing.assert_allclose(got.bias_m, BIAS_M, atol=0.04)
    assert got.significant.all()
    np.testing.assert_array_equal(got.applied_m, got.bias_m)
    np.testing.assert_array_equal(got.n, 3000)


def test_biases_are_those_of_one_large_least_squares(lab):
    """Single ranges, none late: scipy solves for the track, its motion as assumed, and for all biases at once."""
    simulated = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, 2, duration_s=12, rate_hz=5, std_m=0.03, bias_m=0.1)
    instant = np.arange(len(simulated.t_ns))
    got = estimate(lab, simulated, lab.SQUARE_M, keep=4 * instant + instant % 4)
    t_s = (simulated.t_ns - simulated.t_ns[0]) * 1e-9
    step_s, count = t_s[1], len(t_s)
    shaken = 0.1 * np.array([[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]])
    whiten = np.linalg.inv(np.linalg.cholesky(np.kron(shaken, np.eye(2))))
    move = np.eye(4) + step_s * np.eye(4, k=2)
    start = np.array([*simulated.position_m[0], 0.0, 0.0])
    prior = np.linalg.inv(np.linalg.cholesky(COMMON_STD_M**2 + LINK_STD_M**2 * np.eye(4)))

    def misfit(unknown: Float) -> Float:
        states, bias_m = unknown[:-4].reshape(count, 4), unknown[-4:]
        distance_m = lab.true_ranges(states[:, :2], lab.SQUARE_M)
        return np.concatenate(
            [
                ((simulated.range_m - bias_m - distance_m) / 0.1)[instant, instant % 4],
                ((states[1:] - states[:-1] @ move.T) @ whiten.T).ravel(),
                (states[0] - start) / [0.5, 0.5, 1.0, 1.0],
                prior @ bias_m,
            ]
        )

    first = np.column_stack([simulated.position_m, np.zeros((count, 2))]).ravel()
    solved = least_squares(misfit, np.append(first, np.zeros(4)), method="trf", xtol=1e-10)
    # Ours weighs ranges beyond a std a little less.
    np.testing.assert_allclose(got.bias.bias_m, solved.x[-4:], atol=0.004)


def test_motion_within_a_round_is_no_bias(lab):
    """Rounds of 0.5 s at up to 0.8 m/s: at the mean time of its round, a range is off by up to 0.15 m."""
    series, place_m = round_robin(lab, 3, period_s=0.5, duration_s=120)
    got = run(lab, series)
    np.testing.assert_allclose(got.bias.bias_m, BIAS_M / 5, atol=0.03)
    assert track_error(lab, got, series, place_m) < 0.05


@pytest.mark.parametrize("seed", range(3))
def test_the_smoother_beats_a_plain_filter_over_single_ranges(lab, seed):
    series, place_m = round_robin(lab, seed)
    filtered = lab.rmse(kalman_filter(lab, series, place_m[0]) - place_m)
    for calibrate in (True, False):
        assert track_error(lab, run(lab, series, calibrate=calibrate), series, place_m) < 0.8 * filtered


@pytest.mark.parametrize("seed", range(5))
def test_biases_that_are_not_there_are_not_applied(lab, seed):
    """Four anchors without a bias: positions without one of them agree no better with what is estimated."""
    series, _ = round_robin(lab, 10 + seed, bias_m=np.zeros(4), std_m=0.1)
    got = run(lab, series)
    assert not got.bias.significant.any()
    assert got.bias.corrected_spread_m > 0.7 * got.bias.spread_m
    np.testing.assert_array_equal(got.bias_m, 0)


def test_links_are_corrected_together_or_not_at_all(lab):
    """A link hardly heard goes with the others: its bias is the one that they share, until it tells more."""
    anchors_m = np.vstack([lab.SQUARE_M, [4.0, -1.0, 1.0]])
    simulated = lab.simulate(lab.walk_figure_eight, anchors_m, 1, duration_s=60, bias_m=0.2)
    simulated.series.range_m[5 * 2 + 4 :: 5] = np.nan
    got = estimate(lab, simulated, anchors_m).bias
    assert got.n[4] == 2
    assert got.significant.all()
    np.testing.assert_allclose(got.bias_m, 0.2, atol=0.06)
    assert got.std_m[4] > got.std_m[:4].max()


@pytest.mark.parametrize("bursts", [False, True])
def test_std_is_the_scatter_over_many_logs(lab, bursts):
    """Cautious: a link that is left out takes more of the other biases with it than its noise does."""
    z = []
    for seed in range(12):
        simulated = lab.simulate(
            lab.walk_figure_eight, lab.SQUARE_M, seed, duration_s=30, rate_hz=10, bias_m=BIAS_M, bursts=bursts
        )
        got = estimate(lab, simulated, lab.SQUARE_M).bias
        z.append((got.bias_m - BIAS_M) / got.std_m)
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.2  # measured 0.81, in bursts 1.0


def test_a_short_walk_through_bursts_is_not_made_worse(lab):
    """Seeds at which a track bent by its own wrong biases once seemed to tell them well, and tripled its error."""
    anchors = Anchors(np.arange(3), lab.TRIANGLE_M, np.zeros(3))
    for seed in (39, 60, 72, 85):
        simulated = lab.simulate(lab.walk_straight, lab.TRIANGLE_M, seed, bursts=True)
        errors = []
        for calibrate in (True, False):
            settings = LocateSettings(calibrate=calibrate)
            track = locate(simulated.series, anchors, [TagInfo(0, lab.TAG_HEIGHT_M)], settings).tags[0].track
            errors.append(lab.rmse(track.position_m - simulated.truth_at(track.t_ns)))
        assert errors[0] < 1.1 * errors[1]


def test_a_height_that_is_not_known_is_not_mistaken_for_a_bias(lab):
    """Six anchors at three heights, and a tag carried 0.35 m higher than it was written down, up and down."""
    anchors_m = np.array([(0, 0, 0.3), (8, 0, 2.5), (8, 7, 0.3), (0, 7, 2.5), (4, -1, 1.4), (4, 8, 2.6)], dtype=float)
    bias_m = np.array([0.25, 0.05, 0.1, 0.18, 0.3, 0.05])
    simulated = lab.simulate(lab.walk_figure_eight, anchors_m, 0, duration_s=60, rate_hz=10)
    t_s = (simulated.t_ns - simulated.t_ns[0]) * 1e-9
    height_m = 1.35 + 0.3 * np.sin(2 * np.pi * t_s / 13)
    place_m = np.column_stack([simulated.position_m, height_m])
    range_m = np.linalg.norm(place_m[:, None] - anchors_m, axis=2) + bias_m
    simulated.series.range_m[:] = (range_m + 0.1 * np.random.default_rng(0).standard_normal(range_m.shape)).ravel()
    held, free = (estimate(lab, simulated, anchors_m, height_m=1.0, height_std_m=std_m).bias for std_m in (0.0, 0.5))
    np.testing.assert_allclose(free.bias_m, bias_m, atol=0.07)
    assert np.abs(held.bias_m - bias_m).max() > np.abs(free.bias_m - bias_m).max() + 0.03
    assert (np.abs(free.bias_m - bias_m) < 3.5 * free.std_m).all()
    assert free.significant.all()


def test_biases_do_not_depend_on_the_order_of_anchors(lab):
    simulated = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, 6, duration_s=30, rate_hz=10, bias_m=BIAS_M)
    straight = estimate(lab, simulated, lab.SQUARE_M)
    order = np.array([2, 0, 3, 1])
    simulated.series.anchor[:] = np.argsort(order)[simulated.series.anchor]
    mixed = estimate(lab, simulated, lab.SQUARE_M[order])
    np.testing.assert_allclose(mixed.bias.bias_m, straight.bias.bias_m[order], atol=1e-3)
    np.testing.assert_allclose(mixed.bias.std_m, straight.bias.std_m[order], rtol=0.05)
    assert mixed.spread.lasting_m2 == pytest.approx(straight.spread.lasting_m2, rel=0.05)


def test_late_ranges_do_not_pass_for_a_bias(lab):
    """Three anchors, bursts, no bias: applying a bias that is not there would ruin the track."""
    for seed in range(8):
        simulated = lab.simulate(lab.walk_figure_eight, lab.TRIANGLE_M, seed, duration_s=30, rate_hz=20, bursts=True)
        got = estimate(lab, simulated, lab.TRIANGLE_M).bias
        assert np.abs(got.applied_m).max() < 0.15


def test_what_all_links_share_is_a_state_of_the_smoother_alone(lab):
    """Ranges of 12 s that are all 0.25 m too long: not calibrated, fixes keep the bias; the track does without it."""
    simulated = lab.simulate(lab.walk_straight, lab.SQUARE_M, 7, bias_m=0.25)
    got = run(lab, simulated.series, calibrate=False)
    assert got.bias is None
    np.testing.assert_array_equal(got.bias_m, 0)
    raw = lab.rmse(got.fixes.position_m - simulated.truth_at(got.fix_t_ns))
    assert lab.rmse(got.track.position_m - simulated.truth_at(got.track.t_ns)) < 0.4 * raw
    assert np.median(got.ranges.range_m - got.ranges.predicted_m) == pytest.approx(0.0, abs=0.02)
    assert np.median(got.ranges.weight) > 0.9


def test_an_anchor_never_heard_and_an_empty_log(lab):
    simulated = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, 4, duration_s=30, rate_hz=20)
    simulated.series.range_m[1::4] = np.nan
    got = estimate(lab, simulated, lab.SQUARE_M).bias
    assert got.n[1] == 0
    assert not got.significant[1]
    empty = estimate(lab, simulated, lab.SQUARE_M, keep=slice(0)).bias
    assert not empty.significant.any()
    np.testing.assert_allclose(empty.std_m, np.hypot(COMMON_STD_M, LINK_STD_M))
    assert empty.reason == "too few links to try positions without one of them"
