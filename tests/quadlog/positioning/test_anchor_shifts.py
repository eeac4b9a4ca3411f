from __future__ import annotations

import numpy as np
import pytest

from quadlog.positioning.anchor_survey import AnchorShift, TagEpochs, fit_anchor_shift
from quadlog.positioning.epochs import Epochs

ANCHORS_M = np.array([[0.0, 0.0, 1.2], [8.0, 1.0, 1.2], [7.0, 7.0, 1.2], [1.0, 5.0, 1.2], [4.0, -1.5, 1.2]])


def log_of(lab, seed: int, walk=None, **options) -> TagEpochs:
    options = {"duration_s": 30, "rate_hz": 10} | options
    simulated = lab.simulate(walk or lab.walk_figure_eight, ANCHORS_M, seed, **options)
    return TagEpochs(Epochs(simulated.t_ns, simulated.t_ns, simulated.range_m), lab.TAG_HEIGHT_M)


@pytest.mark.parametrize("shift_m", [(0.0, 0.0), (0.4, -0.3), (-3.0, 2.0)])
def test_ranges_without_noise_put_an_anchor_where_it_is(lab, shift_m):
    """Configured off by minus the shift; only the filter's own smoothing of the walk is left."""
    configured_m = ANCHORS_M.copy()
    configured_m[2, :2] -= shift_m
    got = fit_anchor_shift(log_of(lab, 0, std_m=1e-4), configured_m, 2, 0.1, 1.0)
    assert got is not None
    np.testing.assert_allclose(got.shift_m, shift_m, atol=0.01)
    assert got.lasted_s == pytest.approx(29.9)


def test_a_large_shift_is_placed_as_well_as_none(lab):
    """The first guess comes from the track of the others, so that good ranges are not distrusted for the shift."""
    x_m, y_m = np.tile([0.6, 4.1, 7.6], 3), np.repeat([0.5, 3.5, 6.5], 3)
    ring_m = np.column_stack([x_m, y_m, np.full(9, 1.24)])[[0, 1, 2, 3, 5, 6, 7, 8]]
    simulated = lab.simulate(lab.walk_figure_eight, ring_m, 0, duration_s=30, rate_hz=10, bursts=True, bias_m=0.15)
    log = TagEpochs(Epochs(simulated.t_ns, simulated.t_ns, simulated.range_m), lab.TAG_HEIGHT_M)
    wrong_m = ring_m.copy()
    wrong_m[6, :2] -= 2.0, 3.0
    near, far = (fit_anchor_shift(log, each_m, 6, 0.1, 1.0) for each_m in (ring_m, wrong_m))
    assert near is not None
    assert far is not None
    np.testing.assert_allclose(far.shift_m - [2.0, 3.0], near.shift_m, atol=0.03)


def test_covariance_is_honest_about_links_that_wander(lab):
    """Slowly varying errors, bursts, and biases as they differ between links: twice the degrees of freedom at most."""
    normalised = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        log = log_of(lab, seed, bursts=True, bias_m=rng.uniform(0, 0.3, 5))
        log.epochs.range_m[:] += np.repeat(0.05 * rng.standard_normal((6, 5)), 50, axis=0)
        got = fit_anchor_shift(log, ANCHORS_M, seed % 5, 0.1, 1.0)
        assert got is not None
        normalised.append(got.significance**2)
    assert 0.2 < np.mean(normalised) < 4.0


def test_a_tag_that_stands_still_places_nothing(lab):
    log = log_of(lab, 1, lambda t_s: np.tile([2.0, 3.0], (len(t_s), 1)), bursts=True)
    assert fit_anchor_shift(log, ANCHORS_M, 0, 0.1, 1.0) is None


def test_significance_is_the_length_in_std():
    got = AnchorShift(np.array([0.3, 0.4]), np.diag([0.1**2, 0.2**2]), 60.0)
    assert got.significance == pytest.approx(np.sqrt(9 + 4))
    assert got.widest_std_m == pytest.approx(0.2)


def test_too_few_ranges_together(lab):
    log = log_of(lab, 2)
    log.epochs.range_m[39:, 1] = np.nan
    assert fit_anchor_shift(log, ANCHORS_M, 1, 0.1, 1.0) is None
    assert fit_anchor_shift(log, ANCHORS_M, 0, 0.1, 1.0) is not None
