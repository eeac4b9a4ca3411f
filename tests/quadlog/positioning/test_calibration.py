"""Biases found without truth, and what they do to the track of a tag."""

from __future__ import annotations

import numpy as np
import pytest

from quadlog.messages import RangeSeries
from quadlog.positioning.batch.links import AnchorBias, RangeRows, link_quality, weak_first_path_share

BIAS_M = np.array([0.25, 0.0, 0.1, 0.18])


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


@pytest.mark.parametrize("seed", range(2))
def test_biases_that_are_not_there_are_hardly_applied(lab, seed):
    """Four anchors without a bias: what is subtracted is far below a range's std, and costs the track little."""
    series, place_m = round_robin(lab, 10 + seed, bias_m=np.zeros(4), std_m=0.1)
    got, plain = lab.locate_tag(series, lab.SQUARE_M), lab.locate_tag(series, lab.SQUARE_M, calibrate=False)
    assert np.abs(got.bias.applied_m).max() < 0.05
    assert (np.abs(got.bias.bias_m) < 2.5 * got.bias.std_m).all()
    ours, theirs = (lab.rmse(each.track.position_m - place_m) for each in (got, plain))
    assert ours < 1.15 * theirs


def test_a_link_hardly_heard_has_the_bias_that_all_share_and_a_silent_one_none(lab):
    anchors_m = np.vstack([lab.SQUARE_M, [[4.0, -1.0, 1.0], [9.0, 3.0, 1.2]]])
    simulated = lab.simulate(lab.walk_figure_eight, anchors_m, 1, duration_s=60, bias_m=0.2)
    simulated.series.range_m[6 * 2 + 4 :: 6] = np.nan
    simulated.series.range_m[5::6] = np.nan
    got = lab.locate_tag(simulated.series, anchors_m).bias
    assert got.n[4] == 2
    assert got.applied.tolist() == [True] * 5 + [False]
    assert got.applied_m[5] == 0
    np.testing.assert_allclose(got.bias_m[:5], 0.2, atol=0.06)
    assert got.std_m[4] > got.std_m[:4].max()


@pytest.mark.parametrize("bursts", [False, True])
def test_std_is_the_scatter_over_many_logs(lab, bursts):
    """Cautious: a link that is left out takes more of the other biases with it than its noise does."""
    z = []
    for seed in range(12):
        simulated = lab.simulate(
            lab.walk_figure_eight, lab.SQUARE_M, seed, duration_s=30, rate_hz=10, bias_m=BIAS_M, bursts=bursts
        )
        got = lab.locate_tag(simulated.series, lab.SQUARE_M).bias
        np.testing.assert_allclose(got.applied_m, BIAS_M, atol=0.15)
        assert got.reason.startswith("the ranges favour")
        z.append((got.bias_m - BIAS_M) / got.std_m)
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.3


def test_what_all_links_share_is_a_state_of_the_smoother_alone(lab):
    """Ranges of 12 s that are all 0.25 m too long: not calibrated, fixes keep the bias; the track does without it."""
    simulated = lab.simulate(lab.walk_straight, lab.SQUARE_M, 7, bias_m=0.25)
    got = lab.locate_tag(simulated.series, lab.SQUARE_M, calibrate=False)
    assert got.bias is None
    raw = lab.rmse(got.fixes.position_m - simulated.truth_at(got.epochs.t_ns))
    assert lab.rmse(got.track.position_m - simulated.truth_at(got.track.t_ns)) < 0.4 * raw
    assert np.median(got.ranges.range_m - got.ranges.predicted_m) == pytest.approx(0.0, abs=0.02)
    assert np.median(got.ranges.weight) > 0.9


IDS = np.array([7, 3, 5])


def test_links_in_the_order_of_their_anchors():
    """Late by more than three std is NLOS, early never; what a link has no ranges for is NaN."""
    residual_m = np.array([0.1, -0.9, 0.1, 0.301, 0.0, 0.299, np.nan])
    predicted_m = np.where(np.isnan(residual_m), np.nan, 4.0)
    rows = RangeRows(np.arange(7), np.array([7] * 4 + [3] * 3), np.nan_to_num(residual_m) + 4, predicted_m, np.ones(7))
    bias = AnchorBias(np.array([0.2, 0.01, 0.1]), np.array([0.03, 0.03, 0.16]), np.array([4, 3, 0]), np.eye(4)[3])
    quality = link_quality(rows, IDS, bias, 0.1)
    assert quality["n"].tolist() == [4, 2, 0]
    known = [residual_m[:4], residual_m[4:6]]
    np.testing.assert_allclose(quality["residual_rms_m"], [*(np.sqrt(np.mean(each**2)) for each in known), np.nan])
    np.testing.assert_allclose(quality["residual_median_m"], [*map(np.median, known), np.nan])
    np.testing.assert_allclose(quality["nlos_share"], [0.25, 0.0, np.nan])
    assert quality["bias_applied"].tolist() == [True, True, False]
    assert quality["why_not"].tolist() == ["", "", "no ranges"]
    off = link_quality(rows, IDS, None, 0.1)
    assert np.isnan(off["bias_m"]).all()
    assert set(off["why_not"]) == {"calibration is off"}
    series = RangeSeries(np.arange(6), np.array([0, 0, 0, 0, 1, 0]), np.array([7, 7, 7, 3, 3, 7]), np.ones(6))
    gap_db = np.array([5.9, 6.1, 20.0, np.nan, 9.0, np.nan])
    np.testing.assert_allclose(weak_first_path_share(series, gap_db, 0, IDS), [2 / 3, np.nan, np.nan])
    assert np.isnan(weak_first_path_share(series, None, 0, IDS)).all()
