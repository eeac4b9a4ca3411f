from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.stats import chi2

from quadlog.positioning.dilution import CHI2_95, dilution_at, ellipse_95, map_dilution, radius_95
from quadlog.positioning.fixes import solve_fixes


@pytest.mark.parametrize("count", [3, 4, 8])
@pytest.mark.parametrize("above_m", [0.0, 2.0])
def test_the_middle_of_a_ring_is_known_in_closed_form(count, above_m):
    """sum u u^T is N cos^2(elevation) / 2 times the unit matrix: HDOP 2 / (sqrt(N) cos); 1 for a level square."""
    turn = 2 * np.pi * np.arange(count) / count
    ring_m = np.column_stack([5 * np.cos(turn), 5 * np.sin(turn), np.full(count, 0.6 + above_m)])
    assert_allclose(dilution_at(np.zeros((1, 2)), ring_m, 0.6), 2 * np.hypot(5, above_m) / (np.sqrt(count) * 5))


def test_it_is_what_the_fixes_say_of_themselves_and_infinite_without_any(lab):
    place_m = np.random.default_rng(3).uniform([-3, -3], [11, 10], (300, 2))
    fixes = solve_fixes("gauss_newton", lab.SQUARE_M, lab.true_ranges(place_m, lab.SQUARE_M), 0.6, 0.1, np.inf)
    near = np.hypot(*(fixes.position_m - place_m).T) < 1e-6
    assert near.sum() > 250
    assert_allclose(dilution_at(place_m, lab.SQUARE_M, 0.6)[near], fixes.hdop[near], rtol=1e-5)
    line_m = np.array([[0.0, 0.0, 1.0], [4.0, 0.0, 1.0], [8.0, 0.0, 1.0]])
    assert dilution_at(np.array([[2.0, 0.0]]), line_m, 1.0)[0] == np.inf
    assert dilution_at(np.array([[3.0, 3.0]]), lab.SQUARE_M[:2], 0.6)[0] == np.inf


@given(st.floats(1e-3, 1e4), st.floats(1e-3, 1e4), st.floats(-1e6, 1e6), st.integers(2, 60), st.integers(2, 60))
def test_a_map_covers_the_anchors_and_is_no_larger_than_asked_for_nor_coarse(width_m, depth_m, at_m, rows, columns):
    anchors_m = np.array([[0.0, 0.0, 1.0], [width_m, 0.0, 1.0], [0.0, depth_m, 1.0]]) + np.array([at_m, -at_m, 0.0])
    grid = map_dilution(anchors_m, 0.6, np.zeros((0, 2)), rows, columns)
    assert grid.hdop.shape[0] <= rows
    assert grid.hdop.shape[1] <= columns
    size_m = np.array(grid.hdop.shape[::-1]) * grid.cell_m
    assert (grid.origin_m <= anchors_m[:, :2].min(axis=0)).all()
    assert (grid.origin_m + size_m >= anchors_m[:, :2].max(axis=0)).all()
    extent_m = max(width_m, depth_m, 1.0) * 1.3 + np.abs(at_m) * 1e-12
    assert grid.cell_m <= 1.51 * extent_m / (min(rows, columns) - 1) + 1e-9
    centre_m = grid.origin_m[None] + grid.cell_m * np.array([0.5, len(grid.hdop) - 0.5])
    assert_allclose(grid.hdop[-1:, 0], dilution_at(centre_m, anchors_m, 0.6), rtol=1e-6)


def test_the_map_covers_the_track_but_no_stray(lab):
    track_m = np.array([[4.0, -5.0], [np.nan, 0.0], [4.0, 1e7]])
    grid = map_dilution(lab.SQUARE_M, 0.6, track_m, 100, 100)
    assert grid.origin_m[1] < -5
    assert 8 < grid.origin_m[1] + grid.hdop.shape[0] * grid.cell_m < 50


def test_ellipses_are_those_of_the_eigenvectors_and_radii_end_on_them():
    root = np.random.default_rng(5).normal(0, 0.3, (200, 2, 2))
    covariance_m2 = root @ root.transpose(0, 2, 1) + 1e-4 * np.eye(2)
    values, axes = np.linalg.eigh(covariance_m2)
    for semi_axis_m, k in zip(ellipse_95(covariance_m2), (1, 0), strict=True):
        assert_allclose(semi_axis_m, np.sqrt(chi2.ppf(0.95, 2) * values[:, k]))
        assert_allclose(radius_95(covariance_m2, axes[:, :, k]), semi_axis_m)
    error_m = np.random.default_rng(7).normal(size=(200, 2))
    end_m = error_m / np.hypot(*error_m.T)[:, None] * radius_95(covariance_m2, error_m)[:, None]
    assert_allclose(np.einsum("ni,nij,nj->n", end_m, np.linalg.inv(covariance_m2), end_m), CHI2_95)
    unknown = radius_95(
        np.stack([np.eye(2), np.eye(2), np.full((2, 2), np.nan)]), np.array([[0, 0], [np.nan] * 2, [1, 0]])
    )
    assert_allclose(unknown, [np.sqrt(CHI2_95), np.nan, np.nan])
