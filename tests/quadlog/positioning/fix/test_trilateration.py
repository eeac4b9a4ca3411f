"""What every method has to hold."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quadlog.errors import UnknownName
from quadlog.positioning.fix.trilateration import METHODS, solve_fixes

HALL_M = np.array([[0, 0, 0.3], [8, 0, 2.6], [8, 7, 0.4], [0, 7, 2.5], [4, 0, 2.8], [4, 7, 0.2]], dtype=float)
NAMES = sorted(METHODS)
RANGES = st.lists(st.floats(1e-3, 1e4) | st.just(np.nan), min_size=6, max_size=6)


def noisy_ranges(anchors_m, n=30, seed=1, height_m=0.6):
    rng = np.random.default_rng(seed)
    place_m = np.column_stack([rng.uniform(2, 6, n), rng.uniform(2, 5, n), np.full(n, height_m)])
    range_m = np.linalg.norm(place_m[:, None, :] - anchors_m, axis=2)
    return place_m, range_m + 0.1 * rng.standard_normal(range_m.shape)


def test_the_names_are_the_contracts():
    assert set(METHODS) == {"gauss_newton", "linear", "weighted", "paper", "huber"}
    with pytest.raises(UnknownName, match="gauss_newton"):
        solve_fixes("newton", HALL_M, np.ones((1, 6)), 0.6, 0.1, 0.5)


@pytest.mark.parametrize("method", NAMES)
@pytest.mark.parametrize("height_m", [0.6, None])
@given(RANGES)
def test_solved_means_finite_whatever_was_measured(method, height_m, range_m):
    fixes = solve_fixes(method, HALL_M, np.array([range_m]), height_m, 0.1, 0.5)
    heard = np.isfinite(range_m)
    numbers = [fixes.position_m[0], fixes.covariance_m2[0].ravel(), fixes.residual_rms_m, fixes.residual_m[0, heard]]
    numbers += [fixes.z_m, fixes.z_std_m, fixes.hdop]
    assert fixes.n_ranges[0] == heard.sum()
    if fixes.solved[0]:
        assert np.isfinite(np.concatenate(numbers)).all()
        assert np.linalg.eigvalsh(fixes.covariance_m2[0]).min() > 0
        assert (fixes.z_std_m[0] > 0) == (height_m is None)
    else:
        assert np.isnan(np.concatenate(numbers)).all()
        assert not fixes.outlier[0]
    assert fixes.degenerate[0] == (fixes.n_ranges[0] >= (4 if height_m is None else 3) and not fixes.solved[0])


@pytest.mark.parametrize("method", NAMES)
@pytest.mark.parametrize("height_m", [0.6, None])
def test_moving_the_room_moves_the_fixes(method, height_m):
    """A turn and a shift of the map, heights kept."""
    _, range_m = noisy_ranges(HALL_M)
    range_m[::3, 1] = np.nan
    turn = Rotation.from_euler("z", 40, degrees=True).as_matrix()
    shift_m = np.array([100.0, -30.0, 0.0])
    one = solve_fixes(method, HALL_M, range_m, height_m, 0.1, 0.5)
    two = solve_fixes(method, HALL_M @ turn.T + shift_m, range_m, height_m, 0.1, 0.5)
    np.testing.assert_array_equal(one.solved, two.solved)
    np.testing.assert_allclose(one.position_m @ turn[:2, :2].T + shift_m[:2], two.position_m, atol=2e-4)
    turned = turn[:2, :2] @ one.covariance_m2 @ turn[:2, :2].T
    np.testing.assert_allclose(turned, two.covariance_m2, rtol=1e-2, atol=1e-5)
    np.testing.assert_allclose(one.z_m, two.z_m, atol=1e-3)
    np.testing.assert_allclose(one.hdop, two.hdop, rtol=1e-3)


@pytest.mark.parametrize("method", [name for name in NAMES if name != "paper"])
@pytest.mark.parametrize("height_m", [0.6, None])
def test_the_order_of_the_anchors_does_not_matter(method, height_m):
    """The paper's method is the exception: its last station is special."""
    _, range_m = noisy_ranges(HALL_M)
    order = [3, 5, 0, 4, 1, 2]
    one = solve_fixes(method, HALL_M, range_m, height_m, 0.1, 0.5)
    two = solve_fixes(method, HALL_M[order], range_m[:, order], height_m, 0.1, 0.5)
    np.testing.assert_allclose(one.position_m, two.position_m, atol=2e-4)
    np.testing.assert_allclose(one.residual_m[:, order], two.residual_m, atol=3e-4)


@pytest.mark.parametrize("method", NAMES)
@pytest.mark.parametrize("height_m", [0.6, None])
def test_an_absent_anchor_is_as_one_that_is_not_there(method, height_m):
    _, range_m = noisy_ranges(HALL_M)
    range_m[:, 2] = np.nan
    kept = [0, 1, 3, 4, 5]
    one = solve_fixes(method, HALL_M, range_m, height_m, 0.1, 0.5)
    two = solve_fixes(method, HALL_M[kept], range_m[:, kept], height_m, 0.1, 0.5)
    np.testing.assert_allclose(one.position_m, two.position_m, atol=2e-4)
    np.testing.assert_array_equal(one.n_ranges, 5)
    assert np.isnan(one.residual_m[:, 2]).all()


@pytest.mark.parametrize("method", NAMES)
@pytest.mark.parametrize("known", [True, False], ids=["height known", "height solved for"])
@given(st.floats(0.5, 7.5), st.floats(0.5, 6.5), st.floats(-2, 2), st.floats(-5e6, 5e6), st.floats(-5e6, 5e6))
def test_exact_ranges_give_the_place_back(method, known, x_m, y_m, z_m, east_m, north_m):
    """Anywhere on the map, at any height below or above the anchors."""
    anchors_m, place_m = (np.add(each, [east_m, north_m, 0.0]) for each in (HALL_M, [[x_m, y_m, z_m]]))
    range_m = np.linalg.norm(place_m[:, None] - anchors_m, axis=2)
    fixes = solve_fixes(method, anchors_m, range_m, z_m if known else None, 1e-5, 0.5)
    np.testing.assert_allclose(fixes.position_m, place_m[:, :2], atol=1e-6)
    np.testing.assert_allclose(fixes.z_m, z_m, atol=1e-6)
    np.testing.assert_allclose(fixes.residual_m, 0, atol=1e-5)


@pytest.mark.parametrize("method", NAMES)
@pytest.mark.parametrize(("height_m", "flat"), [(0.6, [1, 0, 1]), (None, [1, 1, 0])], ids=["on a line", "level"])
def test_too_few_ranges_and_flat_geometry_are_not_solved(method, height_m, flat):
    _, range_m = noisy_ranges(HALL_M, 3)
    range_m[1, 2:] = np.nan
    fixes = solve_fixes(method, HALL_M * flat, range_m, height_m, 0.1, 0.5)
    np.testing.assert_array_equal(fixes.solved, [False] * 3)
    np.testing.assert_array_equal(fixes.degenerate, [True, False, True])
    assert not solve_fixes(method, HALL_M, range_m, height_m, 0.1, 0.5).solved[1]


@pytest.mark.parametrize("method", NAMES)
def test_nothing_in_nothing_out(method):
    fixes = solve_fixes(method, HALL_M, np.empty((0, 6)), None, 0.1, 0.5)
    assert fixes.position_m.shape == (0, 2)
    assert fixes.covariance_m2.shape == (0, 2, 2)


@pytest.mark.parametrize(
    ("method", "raw_m", "unbiased_m"),
    [
        ("gauss_newton", 0.182, 0.085),
        ("huber", 0.25, 0.082),
        ("weighted", 0.17, 0.084),
        ("linear", 0.17, 0.092),
        ("paper", 0.20, 0.092),
    ],
)
def test_real_ranges_of_a_trolley(lab, trolley, method, raw_m, unbiased_m):
    """Tag 0, as measured and with each anchor's median error against the truth removed. One-sided weights are the
    best of all on unbiased ranges, and the worst on ranges that are all too long.
    """
    rows = trolley.series.tag == 0
    range_m = trolley.series.range_m[rows].reshape(-1, 8)
    range_m = np.where((range_m > 0.05) & (range_m < 300), range_m, np.nan)
    truth_m = trolley.truth_at(0, trolley.series.t_ns[rows].reshape(-1, 8)[:, 0])
    bias_m = np.nanmedian(range_m - lab.true_ranges(truth_m, trolley.anchors_m, 0.97), axis=0)
    for subtracted_m, limit_m in ((0.0, raw_m), (bias_m, unbiased_m)):
        fixes = solve_fixes(method, trolley.anchors_m, range_m - subtracted_m, 0.97, 0.1, 0.5)
        assert fixes.solved.mean() > 0.999
        assert lab.rmse((fixes.position_m - truth_m)[fixes.solved]) < limit_m
