"""Biases found without truth, and what they do to the track of a tag."""

from __future__ import annotations

import numpy as np
import pytest

from quadlog.messages import RangeSeries
from quadlog.positioning.batch.links import weak_first_path_share

BIAS_M = np.array([0.25, 0.0, 0.1, 0.18])


@pytest.mark.parametrize("seed", range(2))
def test_biases_that_are_not_there_are_hardly_applied(lab, seed):
    """Four anchors without a bias: what is subtracted is far below a range's std, and costs the track little."""
    simulated = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, 10 + seed, duration_s=60, rate_hz=8)
    got, plain = (lab.locate_tag(simulated.series, lab.SQUARE_M, calibrate=each) for each in (True, False))
    assert np.abs(got.bias.applied_m).max() < 0.05
    assert (np.abs(got.bias.bias_m) < 2.5 * got.bias.std_m).all()
    ours, theirs = (lab.rmse(each.track.position_m - simulated.truth_at(each.track.t_ns)) for each in (got, plain))
    assert ours < 1.15 * theirs


def test_a_link_hardly_heard_has_the_bias_that_all_share_and_a_silent_one_none(lab):
    anchors_m = np.vstack([lab.SQUARE_M, [[4.0, -1.0, 1.0], [9.0, 3.0, 1.2]]])
    simulated = lab.simulate(lab.walk_figure_eight, anchors_m, 1, duration_s=60, bias_m=0.2)
    simulated.series.range_m[6 * 2 + 4 :: 6] = np.nan
    simulated.series.range_m[5::6] = np.nan
    got = lab.locate_tag(simulated.series, anchors_m).bias
    assert got.n[4] == 2
    assert (got.n > 0).tolist() == [True] * 5 + [False]
    assert got.applied_m[5] == 0
    np.testing.assert_allclose(got.bias_m[:5], 0.2, atol=0.06)
    assert got.std_m[4] > 0.95 * got.std_m[:4].max()  # all alike: the ranges favour one bias of all links


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
    assert 0.45 < np.sqrt(np.mean(np.square(z))) < 1.3


def test_what_all_links_share_is_a_state_of_the_smoother_alone(lab):
    """Ranges of 12 s that are all 0.25 m too long: not calibrated, fixes keep the bias; the track does without it."""
    simulated = lab.simulate(lab.walk_straight, lab.SQUARE_M, 7, bias_m=0.25)
    got = lab.locate_tag(simulated.series, lab.SQUARE_M, calibrate=False)
    assert got.bias is None
    raw = lab.rmse(got.fixes.position_m - simulated.truth_at(got.epochs.t_ns))
    assert lab.rmse(got.track.position_m - simulated.truth_at(got.track.t_ns)) < 0.4 * raw
    assert np.median(got.ranges.range_m - got.ranges.predicted_m) == pytest.approx(0.0, abs=0.02)
    assert np.median(got.ranges.weight) > 0.9


@pytest.mark.parametrize("scale", [1.0, 0.96, 1.07])
def test_ranges_with_a_scale_are_divided_by_it_and_others_are_left_alone(lab, scale):
    anchors_m = 3 * lab.SQUARE_M
    simulated = lab.simulate(lambda t_s: 3 * lab.walk_figure_eight(t_s), anchors_m, 4, duration_s=40, rate_hz=10)
    simulated.series.range_m[:] = scale * simulated.series.range_m + 0.1
    got = lab.locate_tag(simulated.series, anchors_m)
    assert abs(1 + got.bias.scale - scale) <= max(3 * got.bias.scale_std, 1e-9)
    assert lab.rmse(got.track.position_m - simulated.truth_at(got.track.t_ns)) < 0.15
    fixed = got.fixes.solved & ~got.fixes.outlier
    assert lab.rmse((got.fixes.position_m - simulated.truth_at(got.epochs.t_ns))[fixed]) < 0.25


def test_of_noisy_ranges_the_std_is_estimated_for_what_the_track_takes_up(lab):
    """Few ranges of a walker: their residuals are far smaller than their errors."""
    found = []
    for seed in (5, 6):
        simulated = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, seed, duration_s=60, rate_hz=2, std_m=0.1)
        found.append(np.median(lab.locate_tag(simulated.series, lab.SQUARE_M).range_std_m))
    assert np.mean(found) == pytest.approx(0.1, rel=0.15)


def test_the_share_of_weak_first_paths_is_over_what_is_known_of_a_link():
    series = RangeSeries(np.arange(6), np.array([0, 0, 0, 0, 1, 0]), np.array([7, 7, 7, 3, 3, 7]), np.ones(6))
    gap_db = np.array([5.9, 6.1, 20.0, np.nan, 9.0, np.nan])
    ids = np.array([7, 3, 5])
    np.testing.assert_allclose(weak_first_path_share(series, gap_db, 0, ids), [2 / 3, np.nan, np.nan])
    assert np.isnan(weak_first_path_share(series, None, 0, ids)).all()
