from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from quadlog.messages import Float
from quadlog.positioning.calibration import AnchorBias, estimate_anchor_bias, solve_biases
from quadlog.positioning.epochs import Epochs

BIAS_M = np.array([0.25, 0.0, 0.1, 0.18])


def estimate(lab, simulated, anchors_m: Float) -> AnchorBias:
    epochs = Epochs(simulated.t_ns, simulated.t_ns, simulated.range_m)
    return estimate_anchor_bias(epochs, anchors_m, lab.TAG_HEIGHT_M, 0.1, 1.0)


def test_biases_and_fixes_are_those_of_one_large_least_squares(lab):
    rng = np.random.default_rng(0)
    place_m = rng.uniform(1, 6, (12, 2))
    range_m = lab.true_ranges(place_m, lab.SQUARE_M) + BIAS_M + 0.05 * rng.standard_normal((12, 4))
    weight = rng.uniform(50, 100, (12, 4))

    def residual(unknowns):
        fixes_m, bias_m = unknowns[4:].reshape(-1, 2), unknowns[:4]
        misfit = np.sqrt(weight) * (range_m - bias_m - lab.true_ranges(fixes_m, lab.SQUARE_M))
        return np.concatenate([misfit.ravel(), bias_m / 0.2])

    oracle = least_squares(residual, np.concatenate([np.zeros(4), place_m.ravel()]), xtol=1e-12, ftol=1e-12)
    bias_m, std_m = solve_biases(lab.SQUARE_M, range_m, weight, place_m, lab.TAG_HEIGHT_M)
    np.testing.assert_allclose(bias_m, oracle.x[:4], atol=1e-3)
    exact = np.sqrt(np.diag(np.linalg.inv(oracle.jac.T @ oracle.jac)))[:4]
    assert (std_m >= 0.99 * exact).all()


def test_biases_are_found_without_truth(lab):
    simulated = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, 1, duration_s=60, bias_m=BIAS_M)
    got = estimate(lab, simulated, lab.SQUARE_M)
    np.testing.assert_allclose(got.bias_m, BIAS_M, atol=0.04)
    assert got.significant.all()
    np.testing.assert_array_equal(got.applied_m, got.bias_m)
    np.testing.assert_array_equal(got.n, 3000)


def test_links_are_corrected_together_or_not_at_all(lab):
    """A short log under the same biases: they cannot be told from the place, and none is applied."""
    short = estimate(lab, lab.simulate(lab.walk_figure_eight, lab.TRIANGLE_M, 1, duration_s=3), lab.TRIANGLE_M)
    assert short.std_m.max() > 0.06
    assert not short.significant.any()
    np.testing.assert_array_equal(short.applied_m, 0)


def test_a_link_hardly_heard_does_not_keep_the_others_from_being_corrected(lab):
    simulated = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, 1, duration_s=60, bias_m=BIAS_M)
    simulated.range_m[2:, 3] = np.nan
    got = estimate(lab, simulated, lab.SQUARE_M)
    np.testing.assert_array_equal(got.significant, [True, True, True, False])
    assert got.applied_m[3] == 0


def test_std_is_the_scatter_over_many_logs(lab):
    found = [
        estimate(
            lab,
            lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, s, duration_s=30, rate_hz=10, bias_m=BIAS_M),
            lab.SQUARE_M,
        )
        for s in range(30)
    ]
    z = np.array([(each.bias_m - BIAS_M) / each.std_m for each in found])
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.5


def test_late_ranges_do_not_pass_for_a_bias(lab):
    """Three anchors, bursts, no bias: applying a bias that is not there would ruin the track."""
    for seed in range(8):
        simulated = lab.simulate(lab.walk_figure_eight, lab.TRIANGLE_M, seed, duration_s=30, rate_hz=20, bursts=True)
        got = estimate(lab, simulated, lab.TRIANGLE_M)
        assert np.abs(got.applied_m).max() < 0.25


def test_a_standing_tag_shows_no_bias(lab):
    simulated = lab.simulate(
        lambda t_s: np.tile([2.0, 3.0], (len(t_s), 1)), lab.TRIANGLE_M, 3, bias_m=np.array([0.3, 0.1, 0.0])
    )
    got = estimate(lab, simulated, lab.TRIANGLE_M)
    assert not got.significant.any()
    assert got.std_m.min() > 0.05


def test_an_anchor_never_heard_and_an_empty_log(lab):
    simulated = lab.simulate(lab.walk_figure_eight, lab.SQUARE_M, 4, duration_s=30, rate_hz=20)
    simulated.range_m[:, 1] = np.nan
    got = estimate(lab, simulated, lab.SQUARE_M)
    assert got.n[1] == 0
    assert got.bias_m[1] == pytest.approx(0)
    assert got.std_m[1] == pytest.approx(0.2)
    none = np.empty(0, dtype=np.int64)
    empty = estimate_anchor_bias(Epochs(none, none, np.empty((0, 4))), lab.SQUARE_M, 0.6, 0.1, 1.0)
    assert not empty.significant.any()
