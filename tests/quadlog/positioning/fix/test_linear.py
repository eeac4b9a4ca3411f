from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.positioning.fix.linear import solve_linear, solve_paper, solve_weighted

ROOM_M = np.array([[0.0, 0.0, 1.2], [8.0, 0.5, 1.4], [8.0, 7.0, 1.0], [0.0, 7.0, 1.2], [4.0, 8.0, 1.3]])
HALL_M = np.array([[0, 0, 0.3], [8, 0, 2.6], [8, 7, 0.4], [0, 7, 2.5], [4, 0, 2.8], [4, 7, 0.2]], dtype=float)
SOLVERS = [solve_linear, solve_weighted, solve_paper]


def noisy_ranges(anchors_m, height_m, n, seed, std_m=0.1):
    rng = np.random.default_rng(seed)
    place_m = np.column_stack([rng.uniform(2, 6, n), rng.uniform(2, 5, n), np.full(n, height_m)])
    range_m = np.linalg.norm(place_m[:, None, :] - anchors_m, axis=2)
    return place_m, range_m + std_m * rng.standard_normal(range_m.shape)


def differences(anchors_m, square_m2, reference):
    """The rows of [Following], right form: station `reference` subtracted from every other one."""
    others = np.delete(np.arange(len(anchors_m)), reference)
    a = 2 * (anchors_m[others] - anchors_m[reference])
    norm_m2 = (anchors_m**2).sum(axis=1)
    return others, a, norm_m2[others] - norm_m2[reference] + square_m2[reference] - square_m2[others]


def full_covariance(range_m, std_m, others, reference):
    variance = 4 * std_m**2 * range_m**2 + 2 * std_m**4
    return np.diag(variance[others]) + variance[reference]


@pytest.mark.parametrize("reference", range(5))
def test_full_covariance_weights_depend_on_no_reference(reference):
    """The form without a reference equals C^-1 of differences against any station."""
    _, range_m = noisy_ranges(ROOM_M, 0.6, 20, 1)
    fixes = solve_weighted(ROOM_M, range_m, 0.6, 0.1, 0.5)
    for i in range(len(range_m)):
        square_m2 = range_m[i] ** 2 - (ROOM_M[:, 2] - 0.6) ** 2
        others, a, b = differences(ROOM_M[:, :2], square_m2, reference)
        information = a.T @ np.linalg.inv(full_covariance(range_m[i], 0.1, others, reference))
        np.testing.assert_allclose(fixes.position_m[i], np.linalg.solve(information @ a, information @ b), rtol=1e-9)
        np.testing.assert_allclose(fixes.covariance_m2[i], np.linalg.inv(information @ a), rtol=1e-9)


def test_linear_is_least_squares_with_the_sum_of_squares_as_an_unknown():
    _, range_m = noisy_ranges(ROOM_M, 0.6, 20, 2)
    fixes = solve_linear(ROOM_M, range_m, 0.6, 0.1, 0.5)
    design = np.column_stack([-2 * ROOM_M[:, :2], np.ones(5)])
    for i in range(len(range_m)):
        right = range_m[i] ** 2 - (ROOM_M[:, 2] - 0.6) ** 2 - (ROOM_M[:, :2] ** 2).sum(axis=1)
        np.testing.assert_allclose(fixes.position_m[i], np.linalg.lstsq(design, right)[0][:2], rtol=1e-9)


def test_paper_is_weighted_by_one_over_distance_against_the_last_station_heard():
    _, range_m = noisy_ranges(ROOM_M, 0.6, 20, 3)
    range_m[:10, 4] = np.nan
    fixes = solve_paper(ROOM_M, range_m, 0.6, 0.1, 0.5)
    for i, heard in enumerate([4] * 10 + [5] * 10):
        square_m2 = range_m[i] ** 2 - (ROOM_M[:, 2] - 0.6) ** 2
        others, a, b = differences(ROOM_M[:heard, :2], square_m2[:heard], heard - 1)
        w = np.diag(1 / range_m[i, others])
        np.testing.assert_allclose(fixes.position_m[i], np.linalg.solve(a.T @ w @ a, a.T @ w @ b), rtol=1e-9)
        gain = np.linalg.solve(a.T @ w @ a, a.T @ w)
        noise = full_covariance(range_m[i, :heard], 0.1, others, heard - 1)
        np.testing.assert_allclose(fixes.covariance_m2[i], gain @ noise @ gain.T, rtol=1e-9)


@given(
    st.lists(st.floats(-10, 10), min_size=6, max_size=6),
    st.lists(st.floats(0.5, 20), min_size=3, max_size=3),
)
def test_with_three_stations_no_weighting_changes_the_fix(xy_m, range_m):
    """What the paper's 0.1 m cannot come from: two equations in two unknowns have one solution, whatever they weigh."""
    anchors_m = np.column_stack([np.reshape(xy_m, (3, 2)), [1.2] * 3])
    fixes = [solve(anchors_m, np.array([range_m]), 0.6, 0.1, 0.5) for solve in SOLVERS]
    if np.linalg.svd(anchors_m[:, :2] - anchors_m[:, :2].mean(axis=0), compute_uv=False)[-1] < 0.5:
        return
    solved = [f for f in fixes if f.solved[0]]
    assert len(solved) in (0, 3)
    for other in solved[1:]:
        scale_m = max(1.0, float(np.abs(solved[0].position_m).max()))
        np.testing.assert_allclose(other.position_m, solved[0].position_m, atol=1e-8 * scale_m)
        np.testing.assert_allclose(other.covariance_m2, solved[0].covariance_m2, rtol=1e-5)


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize(("anchors_m", "height_m"), [(ROOM_M, 0.6), (HALL_M, None)])
def test_ellipses_hold_what_they_promise(lab, solve, anchors_m, height_m):
    place_m, range_m = noisy_ranges(anchors_m, 0.6, 20_000, 5)
    fixes = solve(anchors_m, range_m, height_m, 0.1, 0.5)
    assert fixes.solved.all()
    error_m = fixes.position_m - place_m[:, :2]
    assert 0.94 < lab.share_in_ellipses(error_m, fixes.covariance_m2) < 0.96
    if height_m is None:
        assert 0.94 < np.mean(np.abs(fixes.z_m - 0.6) < 1.96 * fixes.z_std_m) < 0.96
