from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.stats import chi2

from quadlog.positioning.fix.dilution import CHI2_95, dilution_at, ellipse_95, map_dilution, radius_95
from quadlog.positioning.fix.trilateration import solve_gauss_newton

LEVEL_SQUARE_M = np.array([[0.0, 0.0, 1.0], [8.0, 0.0, 1.0], [8.0, 8.0, 1.0], [0.0, 8.0, 1.0]])
ORIGIN = np.zeros((1, 2))


def ring(count: int, radius_m: float, height_m: float) -> np.ndarray:
    turn = 2 * np.pi * np.arange(count) / count
    return np.column_stack([radius_m * np.cos(turn), radius_m * np.sin(turn), np.full(count, height_m)])


@pytest.mark.parametrize("count", [3, 4, 5, 8])
@pytest.mark.parametrize("above_m", [0.0, 2.0])
def test_the_middle_of_a_ring_is_known_in_closed_form(count, above_m):
    """sum u u^T is N cos^2(elevation) / 2 times the unit matrix: HDOP 2 / (sqrt(N) cos); 1 for a level square."""
    radius_m = 5.0
    cos = radius_m / np.hypot(radius_m, above_m)
    assert_allclose(dilution_at(ORIGIN, ring(count, radius_m, 0.6 + above_m), 0.6), 2 / (np.sqrt(count) * cos))


def test_it_is_what_the_fixes_say_of_themselves(lab):
    rng = np.random.default_rng(3)
    place_m = rng.uniform([-3, -3], [11, 10], (300, 2))
    range_m = lab.true_ranges(place_m, lab.SQUARE_M)
    fixes = solve_gauss_newton(lab.SQUARE_M, range_m, lab.TAG_HEIGHT_M, 0.1, np.inf)
    near = np.hypot(*(fixes.position_m - place_m).T) < 1e-6
    assert near.sum() > 250
    assert_allclose(dilution_at(place_m, lab.SQUARE_M, lab.TAG_HEIGHT_M)[near], fixes.hdop[near], rtol=1e-5)


def test_where_no_fix_is_possible_it_is_infinite():
    line_m = np.array([[0.0, 0.0, 1.0], [4.0, 0.0, 1.0], [8.0, 0.0, 1.0]])
    on, off = dilution_at(np.array([[2.0, 0.0], [2.0, 3.0]]), line_m, 1.0)
    assert on == np.inf
    assert np.isfinite(off)
    assert dilution_at(np.array([[3.0, 3.0]]), LEVEL_SQUARE_M[:2], 0.6).tolist() == [np.inf]


def test_cells_hold_the_value_of_their_centre(lab):
    grid = map_dilution(lab.TRIANGLE_M, 0.6, np.zeros((0, 2)), 30, 20)
    centre_m = grid.origin_m + (np.array([7, 4]) + 0.5) * grid.cell_m
    assert grid.hdop[4, 7] == dilution_at(centre_m[None], lab.TRIANGLE_M, 0.6)[0]


def test_the_map_covers_anchors_and_track_but_no_stray():
    track_m = np.array([[4.0, -5.0], [np.nan, 0.0], [4.0, 1e7]])
    grid = map_dilution(LEVEL_SQUARE_M, 0.6, track_m, 100, 100)
    rows, columns = grid.hdop.shape
    low_m, high_m = grid.origin_m, grid.origin_m + np.array([columns, rows]) * grid.cell_m
    assert (low_m < [0, -5]).all()
    assert (high_m > [8, 8]).all()
    assert high_m[1] < 50


@given(st.floats(1e-3, 1e4), st.floats(1e-3, 1e4), st.floats(-1e6, 1e6), st.integers(2, 60), st.integers(2, 60))
def test_a_map_is_never_larger_than_asked_for_nor_needlessly_coarse(width_m, depth_m, at_m, rows, columns):
    anchors_m = np.array([[0.0, 0.0, 1.0], [width_m, 0.0, 1.0], [0.0, depth_m, 1.0]])
    anchors_m += np.array([at_m, -at_m, 0.0])
    grid = map_dilution(anchors_m, 0.6, np.zeros((0, 2)), rows, columns)
    assert grid.hdop.shape[0] <= rows
    assert grid.hdop.shape[1] <= columns
    size_m = np.array(grid.hdop.shape[::-1]) * grid.cell_m
    assert (grid.origin_m <= anchors_m[:, :2].min(axis=0)).all()
    assert (grid.origin_m + size_m >= anchors_m[:, :2].max(axis=0)).all()
    extent_m = max(width_m, depth_m, 1.0) * 1.3 + np.abs(at_m) * 1e-12
    assert grid.cell_m <= 1.51 * extent_m / (min(rows, columns) - 1) + 1e-9


def random_covariances(count: int) -> np.ndarray:
    root = np.random.default_rng(5).normal(0, 0.3, (count, 2, 2))
    return root @ root.transpose(0, 2, 1) + 1e-4 * np.eye(2)


def test_ellipses_are_those_of_the_eigenvectors():
    covariance_m2 = random_covariances(200)
    major_m, minor_m = ellipse_95(covariance_m2)
    values = np.linalg.eigvalsh(covariance_m2)
    assert_allclose(major_m, np.sqrt(chi2.ppf(0.95, 2) * values[:, 1]))
    assert_allclose(minor_m, np.sqrt(chi2.ppf(0.95, 2) * values[:, 0]))


def test_95_of_100_draws_lie_inside():
    covariance_m2 = np.array([[0.04, 0.03], [0.03, 0.05]])
    draws_m = np.random.default_rng(6).multivariate_normal([0, 0], covariance_m2, 100_000)
    radius_m = radius_95(np.tile(covariance_m2, (100_000, 1, 1)), draws_m)
    assert np.mean(np.hypot(*draws_m.T) <= radius_m) == pytest.approx(0.95, abs=0.003)


def test_the_radius_ends_on_the_ellipse():
    covariance_m2 = random_covariances(100)
    error_m = np.random.default_rng(7).normal(size=(100, 2))
    end_m = error_m / np.hypot(*error_m.T)[:, None] * radius_95(covariance_m2, error_m)[:, None]
    assert_allclose(np.einsum("ni,nij,nj->n", end_m, np.linalg.inv(covariance_m2), end_m), CHI2_95)
    _, axes = np.linalg.eigh(covariance_m2)
    for radius_m, axis in zip(ellipse_95(covariance_m2), (1, 0), strict=True):
        assert_allclose(radius_95(covariance_m2, axes[:, :, axis]), radius_m)


def test_no_error_and_no_fix():
    covariance_m2 = np.stack([np.diag([4.0, 1.0]), np.diag([4.0, 1.0]), np.full((2, 2), np.nan)])
    radius_m = radius_95(covariance_m2, np.array([[0.0, 0.0], [np.nan, np.nan], [1.0, 0.0]]))
    assert radius_m[0] == pytest.approx(2 * np.sqrt(CHI2_95))
    assert np.isnan(radius_m[1:]).all()
    assert np.isnan(ellipse_95(covariance_m2)[0][2])
