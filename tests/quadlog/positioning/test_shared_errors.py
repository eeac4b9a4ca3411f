from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from quadlog.messages import Float
from quadlog.positioning.shared_errors import (
    SharedErrors,
    column_medians,
    scatter_covariances,
    solve_shared_errors,
    wander_covariance,
    weigh_by_lateness,
)

ANCHORS_M = np.array([[0.0, 0.0, 0.3], [8.0, 0.0, 2.4], [8.0, 7.0, 0.5], [0.0, 7.0, 2.2], [4.0, -1.0, 1.5]])
BIAS_M = np.array([0.25, 0.0, 0.1, 0.18, 0.3])
NONE = np.empty(0, dtype=np.int64)


def ranges(place_m: Float, anchors_m: Float) -> Float:
    return np.linalg.norm(place_m[:, None, :] - anchors_m, axis=2)


@pytest.mark.parametrize("free_axes", [2, 3])
@pytest.mark.parametrize("moving", [[], [3], [0, 4]])
def test_everything_is_as_in_one_large_least_squares(moving, free_axes):
    """Biases, displacements and their covariance, where scipy solves for every fix as well."""
    rng = np.random.default_rng(0)
    place_m = np.column_stack([rng.uniform(1, 6, (10, 2)), rng.uniform(0.5, 1.0, 10)])
    true_m = ANCHORS_M.copy()
    true_m[moving, :2] += rng.uniform(-0.5, 0.5, (len(moving), 2))
    range_m = ranges(place_m, true_m) + BIAS_M + 0.02 * rng.standard_normal((10, 5))
    weight = rng.uniform(50, 100, (10, 5))
    k = 5 + 2 * len(moving)
    root = np.linalg.cholesky(np.linalg.inv(0.02 * np.eye(k) + 0.02))
    prior = root @ root.T

    def residual(unknowns):
        fixes_m, placed_m = place_m.copy(), ANCHORS_M.copy()
        fixes_m[:, :free_axes] = unknowns[k:].reshape(10, free_axes)
        placed_m[moving, :2] += unknowns[5:k].reshape(-1, 2)
        misfit = np.sqrt(weight) * (range_m - unknowns[:5] - ranges(fixes_m, placed_m))
        return np.concatenate([misfit.ravel(), root.T @ unknowns[:k]])

    start = np.concatenate([np.zeros(k), place_m[:, :free_axes].ravel()])
    oracle = least_squares(residual, start, xtol=1e-10, ftol=1e-10)
    got = solve_shared_errors(ANCHORS_M, np.array(moving, dtype=np.int64), range_m, weight, place_m, free_axes, prior)
    np.testing.assert_allclose(got.bias_m, oracle.x[:5], atol=1e-3)
    np.testing.assert_allclose(got.shift_m.ravel(), oracle.x[5:k], atol=1e-3)
    exact_m2 = np.linalg.inv(oracle.jac.T @ oracle.jac)[:k, :k]
    np.testing.assert_allclose(got.covariance_m2, exact_m2, rtol=5e-2, atol=3e-5)


def test_the_gradient_of_a_range_error_is_its_reach():
    """At the solution, by finite differences of the pull, with the fix following."""
    rng = np.random.default_rng(1)
    place_m = np.column_stack([rng.uniform(1, 6, (6, 2)), np.full(6, 0.6)])
    range_m = ranges(place_m, ANCHORS_M) + BIAS_M
    weight = rng.uniform(50, 100, (6, 5))
    firm = np.eye(7) * 1e12  # what is shared cannot move
    moving = np.array([2])
    base = solve_shared_errors(ANCHORS_M, moving, ranges(place_m, ANCHORS_M), weight, place_m, 2, firm)
    for link in range(5):
        bumped_m = ranges(place_m, ANCHORS_M)
        bumped_m[:, link] += 1e-5
        bumped = solve_shared_errors(ANCHORS_M, moving, bumped_m, weight, place_m, 2, firm)
        np.testing.assert_allclose((bumped.pull - base.pull) / 1e-5, base.reach[:, :, link], rtol=1e-3, atol=1e-2)
    assert np.isfinite(range_m).all()


def test_errors_that_persist_scatter_more_than_white_ones():
    """White gradients give the covariance of the weights; the same ones in runs of 20 give some 20 times as much."""
    rng = np.random.default_rng(4)
    white = rng.standard_normal((800, 1)) * 10
    runs = np.repeat(rng.standard_normal((40, 1)) * 10, 20, axis=0)
    covariance_m2 = np.array([[1 / (100 * 800)]])
    none = np.zeros((800, 1, 1))
    full = np.full((800, 1), 100.0)

    def scatter(pull: Float) -> float:
        errors = SharedErrors(np.zeros(1), np.zeros((0, 2)), covariance_m2, none, pull)
        return float(scatter_covariances(errors, full)[0, 0, 0]) / float(covariance_m2[0, 0])

    assert scatter(white) == pytest.approx(1.0, abs=0.5)
    assert scatter(runs) == pytest.approx(20.0, abs=10.0)


def test_wandering_links_move_a_mean_by_what_averaging_leaves():
    """One number estimated as the mean of 300 s of a link that is off by 0.05 m for 10 s at a time: 0.05 / sqrt(30)."""
    t_s = np.arange(300.0)
    errors = SharedErrors(
        np.zeros(1), np.zeros((0, 2)), np.array([[1 / 300]]), np.ones((300, 1, 1)), np.zeros((300, 1))
    )
    got_m2 = wander_covariance(errors, t_s, 0.05, 10.0)
    assert got_m2[0, 0] == pytest.approx(0.05**2 / 30, rel=1e-9)
    assert wander_covariance(errors, t_s, 0.05, 1e6)[0, 0] == pytest.approx(0.05**2, rel=1e-9)


def test_weights_forgive_a_bias_and_distrust_what_is_late_or_early():
    rng = np.random.default_rng(5)
    residual_m = 0.1 * rng.standard_normal((500, 3)) + [0.0, 3.0, -1.0]
    residual_m[7, 1] += 1.0
    residual_m[8, 1] -= 1.0
    residual_m[9, 1] = np.nan
    weight = weigh_by_lateness(residual_m, 0.1)
    assert weight[9, 1] == 0
    assert max(weight[7, 1], weight[8, 1]) < 0.01 * 100
    np.testing.assert_allclose(np.median(weight, axis=0), np.median(weight), rtol=0.05)
    assert np.median(weight) > 0.7 * 100


def test_medians_pass_over_what_is_not_there():
    rng = np.random.default_rng(6)
    values = rng.standard_normal((41, 4))
    values[rng.random(values.shape) < 0.4] = np.nan
    values[:, 2] = np.nan
    got = column_medians(values)
    np.testing.assert_array_equal(got[[0, 1, 3]], np.nanmedian(values[:, [0, 1, 3]], axis=0))
    assert got[2] == 0
    assert not column_medians(np.empty((0, 3))).any()


@pytest.mark.parametrize("free_axes", [2, 3])
def test_epochs_without_a_sharp_fix_do_not_count(free_axes):
    """Those whose directions hardly differ, as the smallest eigenvalue of U^T W U has it."""
    rng = np.random.default_rng(8)
    place_m = rng.uniform(-9, 15, (60, 3))
    weight = rng.uniform(0, 100, (60, 5)) * (rng.random((60, 5)) < 0.8)
    errors = solve_shared_errors(ANCHORS_M, NONE, ranges(place_m, ANCHORS_M), weight, place_m, free_axes, np.eye(5))
    towards = (place_m[:, None] - ANCHORS_M) / ranges(place_m, ANCHORS_M)[:, :, None]
    normal = np.einsum("ea,eai,eaj->eij", weight, towards[:, :, :free_axes], towards[:, :, :free_axes])
    sharp = np.linalg.eigvalsh(normal)[:, 0] > 0.05 * weight.max()
    assert 0 < sharp.sum() < 60
    np.testing.assert_array_equal(errors.reach.any(axis=(1, 2)), sharp)
