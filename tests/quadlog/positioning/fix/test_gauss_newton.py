from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize

from quadlog.positioning.fix.trilateration import LONG_STD, SHORT_STD, solve_gauss_newton, solve_huber

SQUARE_M = np.array([[0.0, 0.0, 1.2], [8.0, 0.0, 1.2], [8.0, 7.0, 1.2], [0.0, 7.0, 1.2]])
HALL_M = np.array([[0, 0, 0.3], [8, 0, 2.6], [8, 7, 0.4], [0, 7, 2.5], [4, 0, 2.8], [4, 7, 0.2]], dtype=float)


def predict_ranges(position_m, anchors_m, tag_height_m):
    """(E, A) slant distances."""
    places_m = np.column_stack([position_m, np.full(len(position_m), tag_height_m)])
    return np.linalg.norm(places_m[:, None] - anchors_m, axis=2)


def circle(n: int, radius_m: float = 5.0) -> np.ndarray:
    angle = 2 * np.pi * np.arange(n) / n
    return np.column_stack([radius_m * np.cos(angle), radius_m * np.sin(angle), np.full(n, 1.2)])


@pytest.mark.parametrize("height_m", [0.6, None], ids=["plane", "space"])
def test_every_fix_is_the_minimum_that_scipy_finds(height_m):
    rng = np.random.default_rng(5)
    place_m = np.column_stack([rng.uniform(1, 7, 60), rng.uniform(1, 6, 60), rng.uniform(0.3, 2, 60)])
    if height_m is not None:
        place_m[:, 2] = height_m
    range_m = np.linalg.norm(place_m[:, None] - HALL_M, axis=2) + 0.1 * rng.standard_normal((60, 6))
    range_m[rng.random((60, 6)) < 0.1] = np.nan
    fixes = solve_gauss_newton(HALL_M, range_m, height_m, 0.1, 0.5)
    assert fixes.solved.sum() > 50
    axes = 3 if height_m is None else 2
    np.testing.assert_array_equal(fixes.degenerate, ~fixes.solved & (fixes.n_ranges > axes))
    for i in np.flatnonzero(fixes.solved):
        heard = np.isfinite(range_m[i])
        found_m = np.append(fixes.position_m[i], fixes.z_m[i])

        def residual(p, i=i, heard=heard):
            return np.linalg.norm(np.append(p, height_m or [])[:3] - HALL_M[heard], axis=1) - range_m[i, heard]

        oracle = least_squares(residual, found_m[:axes], xtol=1e-14, ftol=1e-14, gtol=1e-14)
        np.testing.assert_allclose(found_m[:axes], oracle.x, atol=1e-4)
        covariance_m2 = 0.01 * np.linalg.inv(oracle.jac.T @ oracle.jac)
        np.testing.assert_allclose(fixes.covariance_m2[i], covariance_m2[:2, :2], rtol=1e-2, atol=1e-6)
        assert fixes.z_std_m[i] == pytest.approx(np.sqrt(covariance_m2[2, 2]) if axes == 3 else 0.0, rel=1e-2)
        assert fixes.residual_rms_m[i] == pytest.approx(np.sqrt(np.mean(oracle.fun**2)), rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("n", [3, 4, 8])
def test_error_reaches_the_cramer_rao_bound_and_ellipses_are_honest(lab, n):
    rng = np.random.default_rng(n)
    anchors_m, place_m = circle(n), np.array([[1.0, 0.7]])
    range_m = lab.true_ranges(place_m, anchors_m) + 0.1 * rng.standard_normal((20_000, n))
    fixes = solve_gauss_newton(anchors_m, range_m, lab.TAG_HEIGHT_M, 0.1, 0.5)
    unit = np.append(place_m[0], lab.TAG_HEIGHT_M) - anchors_m
    unit = (unit / np.linalg.norm(unit, axis=1, keepdims=True))[:, :2]
    bound_m = np.sqrt(np.trace(0.01 * np.linalg.inv(unit.T @ unit)))
    error_m = fixes.position_m - place_m
    assert lab.rmse(error_m) == pytest.approx(bound_m, rel=0.02)
    assert 0.94 < lab.share_in_ellipses(error_m, fixes.covariance_m2) < 0.96


def test_a_subset_on_a_line_is_degenerate_by_epoch(lab):
    anchors_m = np.vstack([SQUARE_M[:2], [[4.0, 0.01, 1.2]], SQUARE_M[2:]])
    range_m = lab.true_ranges(np.array([[2.0, 3.0]] * 2), anchors_m)
    range_m[0, 3:] = np.nan
    fixes = solve_gauss_newton(anchors_m, range_m, lab.TAG_HEIGHT_M, 0.1, 0.5)
    np.testing.assert_array_equal(fixes.degenerate, [True, False])
    np.testing.assert_array_equal(fixes.solved, [False, True])


def test_a_tag_under_an_anchor_is_solved():
    anchors_m = SQUARE_M * [1, 1, 0]
    fixes = solve_gauss_newton(anchors_m, predict_ranges(anchors_m[:1, :2], anchors_m, 0.0), 0.0, 0.1, 0.5)
    np.testing.assert_allclose(fixes.position_m, [[0.0, 0.0]], atol=1e-6)


def test_residuals_that_do_not_fit_are_outliers(lab):
    range_m = lab.true_ranges(np.array([[2.0, 3.0]] * 2), SQUARE_M)
    range_m[1, 0] += 4.0
    fixes = solve_gauss_newton(SQUARE_M, range_m, lab.TAG_HEIGHT_M, 0.1, 0.5)
    np.testing.assert_array_equal(fixes.outlier, [False, True])
    assert fixes.residual_m[1, 0] > 0


def simulated(lab, n, seed, late_share=0.0):
    """A tag within 3 m of the middle of n anchors on a circle of 5 m; late ranges by Exp(0.5 m)."""
    rng = np.random.default_rng(seed)
    angle, radius_m = 2 * np.pi * rng.random(20_000), 3 * np.sqrt(rng.random(20_000))
    place_m = np.column_stack([radius_m * np.cos(angle), radius_m * np.sin(angle)])
    range_m = lab.true_ranges(place_m, circle(n)) + 0.1 * rng.standard_normal((20_000, n))
    return place_m, range_m + (rng.random(range_m.shape) < late_share) * rng.exponential(0.5, range_m.shape)


@pytest.mark.parametrize("height_m", [0.6, None])
def test_huber_fixes_are_minima_of_hubers_loss(lab, height_m):
    rng = np.random.default_rng(4)
    place_m = np.column_stack([rng.uniform(2, 6, 30), rng.uniform(2, 5, 30), np.full(30, 0.6)])
    range_m = np.linalg.norm(place_m[:, None] - HALL_M, axis=2) + 0.1 * rng.standard_normal((30, 6))
    range_m[:, 1] += rng.exponential(1.0, 30)
    fixes = solve_huber(HALL_M, range_m, height_m, 0.1, 0.5)
    assert fixes.solved.all()

    def loss(p, measured_m):
        r = (measured_m - np.linalg.norm(np.append(p, height_m or [])[:3] - HALL_M, axis=1)) / 0.1
        limit = np.where(r > 0, LONG_STD, SHORT_STD)
        return np.where(np.abs(r) <= limit, r**2, limit * (2 * np.abs(r) - limit)).sum()

    for i in range(30):
        found = fixes.position_m[i] if height_m else np.append(fixes.position_m[i], fixes.z_m[i])
        oracle = minimize(loss, found, (range_m[i],), method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-12})
        assert loss(found, range_m[i]) <= oracle.fun * (1 + 1e-5)


@pytest.mark.parametrize(("n", "limit_m"), [(4, 0.225), (5, 0.14), (8, 0.089)])
def test_late_ranges_lose_weight(lab, n, limit_m):
    place_m, range_m = simulated(lab, n, 10 + n, late_share=0.1)
    huber_m = solve_huber(circle(n), range_m, lab.TAG_HEIGHT_M, 0.1, 0.5).position_m - place_m
    plain_m = solve_gauss_newton(circle(n), range_m, lab.TAG_HEIGHT_M, 0.1, 0.5).position_m - place_m
    huber_rmse, plain_rmse = (lab.rmse(e[np.isfinite(e).all(axis=1)]) for e in (huber_m, plain_m))
    assert huber_rmse < limit_m
    assert huber_rmse < 0.85 * plain_rmse


@pytest.mark.parametrize("n", [3, 4, 8])
def test_without_late_ranges_huber_costs_little(lab, n):
    place_m, range_m = simulated(lab, n, 20 + n)
    huber = solve_huber(circle(n), range_m, lab.TAG_HEIGHT_M, 0.1, 0.5)
    plain = solve_gauss_newton(circle(n), range_m, lab.TAG_HEIGHT_M, 0.1, 0.5)
    both = huber.solved & plain.solved
    assert both.mean() > 0.999
    error_m = (huber.position_m - place_m)[both]
    assert lab.rmse(error_m) < 1.03 * lab.rmse((plain.position_m - place_m)[both])
    assert 0.94 < lab.share_in_ellipses(error_m, huber.covariance_m2[both]) < 0.96


def test_fixes_in_space_reach_the_bound_and_their_ellipses_are_honest(lab):
    anchors_m = np.vstack([SQUARE_M * [1, 1, 0] + [0, 0, 0.3], SQUARE_M * [1, 1, 0] + [0, 0, 2.8]])
    rng = np.random.default_rng(6)
    place_m = np.column_stack([rng.uniform(2, 6, 20_000), rng.uniform(2, 5, 20_000), np.full(20_000, 1.0)])
    range_m = np.linalg.norm(place_m[:, None] - anchors_m, axis=2) + 0.1 * rng.standard_normal((20_000, 8))
    fixes = solve_gauss_newton(anchors_m, range_m, None, 0.1, 0.5)
    assert fixes.solved.all()
    unit = place_m[:, None] - anchors_m
    unit /= np.linalg.norm(unit, axis=2, keepdims=True)
    bound_m2 = 0.01 * np.linalg.inv(unit.transpose(0, 2, 1) @ unit)
    error_m = fixes.position_m - place_m[:, :2]
    assert lab.rmse(error_m) == pytest.approx(np.sqrt((bound_m2[:, 0, 0] + bound_m2[:, 1, 1]).mean()), rel=0.02)
    assert np.std(fixes.z_m - 1.0) == pytest.approx(np.sqrt(bound_m2[:, 2, 2].mean()), rel=0.02)
    assert 0.94 < lab.share_in_ellipses(error_m, fixes.covariance_m2) < 0.96
    assert 0.94 < np.mean(np.abs(fixes.z_m - 1.0) < 1.96 * fixes.z_std_m) < 0.96
