"""Fixes of single epochs: what every method holds, the minima that scipy finds, and bounds in closed form."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from quadlog.errors import QuadlogError
from quadlog.positioning.fixes import LONG_STD, METHODS, SHORT_STD, heights_are_told, solve_fixes, solve_on_side

ROOM_M = np.array([[0.0, 0.0, 1.2], [8.0, 0.5, 1.4], [8.0, 7.0, 1.0], [0.0, 7.0, 1.2], [4.0, 8.0, 1.3]])
HALL_M = np.array([[0, 0, 0.3], [8, 0, 2.6], [8, 7, 0.4], [0, 7, 2.5], [4, 0, 2.8], [4, 7, 0.2]], dtype=float)
RANGES = st.lists(st.floats(1e-3, 1e4) | st.just(np.nan), min_size=6, max_size=6)
every_method = pytest.mark.parametrize("method", METHODS)
either_height = pytest.mark.parametrize("height_m", [0.6, None], ids=["height given", "height solved"])


def ranges_to(anchors_m, place_m):
    return np.linalg.norm(np.asarray(place_m)[:, None, :] - anchors_m, axis=2)


def noisy_ranges(anchors_m, n=30, seed=1):
    """Places (n, 3) within the hall at a height of 0.6 m, and ranges with a std of 0.1 m."""
    rng = np.random.default_rng(seed)
    place_m = np.column_stack([rng.uniform(2, 6, n), rng.uniform(2, 5, n), np.full(n, 0.6)])
    return place_m, ranges_to(anchors_m, place_m) + 0.1 * rng.standard_normal((n, len(anchors_m)))


@every_method
@either_height
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


@every_method
@pytest.mark.parametrize("known", [True, False], ids=["height given", "height solved"])
@given(st.floats(0.5, 7.5), st.floats(0.5, 6.5), st.floats(-2, 2), st.floats(-5e6, 5e6), st.floats(-5e6, 5e6))
def test_exact_ranges_give_the_place_back_anywhere_on_the_map(method, known, x_m, y_m, z_m, east_m, north_m):
    anchors_m, place_m = (np.add(each, [east_m, north_m, 0.0]) for each in (HALL_M, [[x_m, y_m, z_m]]))
    fixes = solve_fixes(method, anchors_m, ranges_to(anchors_m, place_m), z_m if known else None, 1e-5, 0.5)
    np.testing.assert_allclose(fixes.position_m, place_m[:, :2], atol=1e-6)
    np.testing.assert_allclose(fixes.z_m, z_m, atol=1e-6)
    np.testing.assert_allclose(fixes.residual_m, 0, atol=1e-5)


@every_method
@pytest.mark.parametrize(("height_m", "flat"), [(0.6, [1, 0, 1]), (None, [1, 1, 0])], ids=["on a line", "level"])
def test_too_few_ranges_and_flat_geometry_are_not_solved(method, height_m, flat):
    range_m = noisy_ranges(HALL_M, 3)[1]
    range_m[1, 2:] = np.nan
    fixes = solve_fixes(method, HALL_M * flat, range_m, height_m, 0.1, 0.5)
    np.testing.assert_array_equal(fixes.solved, [False] * 3)
    np.testing.assert_array_equal(fixes.degenerate, [True, False, True])
    assert not solve_fixes(method, HALL_M, range_m, height_m, 0.1, 0.5).solved[1]
    assert solve_fixes(method, HALL_M, range_m[:0], height_m, 0.1, 0.5).covariance_m2.shape == (0, 2, 2)


@every_method
@pytest.mark.parametrize(("anchors_m", "height_m"), [(ROOM_M, 0.6), (HALL_M, None)])
def test_ellipses_hold_what_they_promise(lab, method, anchors_m, height_m):
    """And maximum likelihood reaches the Cramér-Rao bound."""
    place_m, range_m = noisy_ranges(anchors_m, 20_000, 5)
    fixes = solve_fixes(method, anchors_m, range_m, height_m, 0.1, 0.5)
    good = fixes.solved
    assert good.mean() > 0.999
    error_m = (fixes.position_m - place_m[:, :2])[good]
    assert 0.94 < lab.share_in_ellipses(error_m, fixes.covariance_m2[good]) < 0.96
    if height_m is None:
        assert 0.94 < np.mean(np.abs(fixes.z_m - 0.6) < 1.96 * fixes.z_std_m) < 0.96
    if method == "gauss_newton":
        unit = (place_m[:, None] - anchors_m)[:, :, : 2 if height_m else 3] / ranges_to(anchors_m, place_m)[:, :, None]
        bound_m2 = 0.01 * np.linalg.inv(unit.transpose(0, 2, 1) @ unit)[:, :2, :2]
        assert lab.rmse(error_m) == pytest.approx(np.sqrt(np.trace(bound_m2, axis1=1, axis2=2).mean()), rel=0.02)
        np.testing.assert_allclose(0.01 * fixes.hdop**2, np.trace(fixes.covariance_m2, axis1=1, axis2=2), rtol=1e-6)


@either_height
@pytest.mark.parametrize("method", ["gauss_newton", "huber"])
def test_every_fix_is_the_minimum_that_scipy_finds(method, height_m):
    range_m = noisy_ranges(HALL_M, 30, 4)[1]
    range_m[:, 1] += np.random.default_rng(4).exponential(1.0, 30)
    range_m[::4, 0] = np.nan
    fixes = solve_fixes(method, HALL_M, range_m, height_m, 0.1, 0.5)
    assert fixes.solved.sum() > 25
    limits = (LONG_STD, SHORT_STD) if method == "huber" else (1e9, 1e9)

    def loss(p, measured_m):
        r = (measured_m - np.linalg.norm(np.append(p, height_m or [])[:3] - HALL_M, axis=1)) / 0.1
        limit = np.where(r > 0, *limits)
        return np.nansum(np.where(np.abs(r) <= limit, r**2, limit * (2 * np.abs(r) - limit)))

    for i in np.flatnonzero(fixes.solved):
        found = fixes.position_m[i] if height_m else np.append(fixes.position_m[i], fixes.z_m[i])
        oracle = minimize(loss, found, (range_m[i],), method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-12})
        assert loss(found, range_m[i]) <= oracle.fun * (1 + 1e-5)


@pytest.mark.parametrize("reference", range(5))
def test_linear_methods_are_the_papers_differences_against_a_station(reference):
    """Right form of [Following]: rows less that of a station. Full weights depend on none; the paper's is the last."""
    range_m = noisy_ranges(ROOM_M, 20)[1]
    weighted, linear, paper = (
        solve_fixes(each, ROOM_M, range_m, 0.6, 0.1, 0.5) for each in ("weighted", "linear", "paper")
    )
    others, xy_m = np.delete(np.arange(5), reference), ROOM_M[:, :2]
    a, norm_m2 = 2 * (xy_m[others] - xy_m[reference]), (xy_m**2).sum(axis=1)
    for i, measured_m in enumerate(range_m):
        row_m2, variance = norm_m2 - measured_m**2 + (ROOM_M[:, 2] - 0.6) ** 2, 0.04 * measured_m**2 + 0.0002
        b, noise = row_m2[others] - row_m2[reference], np.diag(variance[others]) + variance[reference]
        information = a.T @ np.linalg.inv(noise)
        np.testing.assert_allclose(weighted.position_m[i], np.linalg.solve(information @ a, information @ b), rtol=1e-9)
        np.testing.assert_allclose(weighted.covariance_m2[i], np.linalg.inv(information @ a), rtol=1e-9)
        alike = np.linalg.lstsq(np.column_stack([2 * xy_m, np.ones(5)]), row_m2)[0][:2]
        np.testing.assert_allclose(linear.position_m[i], alike, rtol=1e-9)
        if reference == 4:
            gain = np.linalg.solve((a.T / measured_m[others]) @ a, a.T / measured_m[others])
            np.testing.assert_allclose(paper.position_m[i], gain @ b, rtol=1e-9)
            np.testing.assert_allclose(paper.covariance_m2[i], gain @ noise @ gain.T, rtol=1e-9)


def test_late_ranges_lose_weight_with_huber_and_mark_outliers(lab):
    place_m, range_m = noisy_ranges(HALL_M, 5000, 14)
    rng = np.random.default_rng(15)
    range_m += (rng.random(range_m.shape) < 0.1) * rng.exponential(0.5, range_m.shape)
    errors_m = [solve_fixes(each, HALL_M, range_m, 0.6, 0.1, 0.5).position_m - place_m[:, :2] for each in METHODS[:2]]
    plain_m, huber_m = (lab.rmse(each[np.isfinite(each).all(axis=1)]) for each in errors_m)
    assert huber_m < 0.85 * plain_m
    range_m = ranges_to(HALL_M, place_m[:2])
    range_m[1, 0] += 4.0
    np.testing.assert_array_equal(solve_fixes("gauss_newton", HALL_M, range_m, 0.6, 0.1, 0.5).outlier, [False, True])


@pytest.mark.parametrize(("off_m", "share"), [(0.06, 0.2), (0.2, 0.98), (0.6, 1.0)])
def test_anchors_near_a_line_solve_only_what_has_no_image(lab, off_m, share):
    """The nearer to a line, the fewer epochs have a fix; but those are on the right side, and their ellipses hold."""
    anchors_m = np.array([[0.0, off_m, 1.2], [3.0, -off_m, 1.2], [6.0, off_m, 1.2], [9.0, -off_m, 1.2]])
    rng = np.random.default_rng(1)
    place_m = np.column_stack([rng.uniform(0, 8, 5000), rng.uniform(1, 6, 5000), np.full(5000, 0.6)])
    range_m = ranges_to(anchors_m, place_m) + 0.1 * rng.standard_normal((5000, 4))
    fixes = solve_fixes("gauss_newton", anchors_m, range_m, 0.6, 0.1, 0.5)
    assert share / 10 < fixes.solved.mean() <= share
    assert np.mean(fixes.position_m[fixes.solved, 1] < 0) < 0.1
    np.testing.assert_array_equal(fixes.degenerate, ~fixes.solved)
    if share == 1:
        error_m = (fixes.position_m - place_m[:, :2])[fixes.solved]
        assert 0.94 < lab.share_in_ellipses(error_m, fixes.covariance_m2[fixes.solved]) < 0.96


LINE_M = np.array([[0.0, 0.0, 1.2], [3.0, 1.0, 1.2], [6.0, 2.0, 1.4], [9.0, 3.0, 1.0]])
ACROSS = np.array([-1.0, 3.0]) / np.sqrt(10)


def walk_left(n):
    t = np.linspace(0, 2 * np.pi, n)
    return np.column_stack([4 + 3 * np.cos(t), 5.5 + 1.5 * np.sin(2 * t)])


def test_sides_are_those_of_the_way_from_the_first_anchor_to_the_last(lab):
    place_m = walk_left(10)
    image_m = place_m - 2 * (place_m @ ACROSS)[:, None] * ACROSS
    for order in permutations(range(4)):
        line_m = LINE_M[list(order)]
        left_m, right_m = (place_m, image_m) if order[0] < order[-1] else (image_m, place_m)
        for side, truth_m in (("left", left_m), ("right", right_m), (right_m + 0.1, right_m)):
            fixes = solve_on_side(line_m, lab.true_ranges(place_m, line_m), lab.TAG_HEIGHT_M, 0.1, 0.5, side)
            np.testing.assert_allclose(fixes.position_m, truth_m, atol=1e-6)


def test_a_fix_is_on_the_side_of_its_start_and_as_good_as_the_geometry_allows_or_is_none(lab):
    """Near the line nothing tells the side."""
    rng, place_m = np.random.default_rng(2), walk_left(20_000)
    range_m = lab.true_ranges(place_m, LINE_M) + 0.1 * rng.standard_normal((20_000, 4))
    fixes = solve_on_side(LINE_M, range_m, lab.TAG_HEIGHT_M, 0.1, 0.5, "left")
    assert fixes.solved.mean() > 0.999
    error_m = (fixes.position_m - place_m)[fixes.solved]
    assert lab.rmse(error_m) == pytest.approx(0.1 * np.sqrt((fixes.hdop[fixes.solved] ** 2).mean()), rel=0.03)
    assert 0.94 < lab.share_in_ellipses(error_m, fixes.covariance_m2[fixes.solved]) < 0.96
    place_m = np.array([4.5, 1.5]) + 4 * np.linspace(-1, 1, 4001)[:, None] * ACROSS
    range_m, off_m = lab.true_ranges(place_m, LINE_M) + 0.1 * rng.standard_normal((4001, 4)), place_m @ ACROSS
    range_m[1, 2:], beside_m = np.nan, place_m + np.where(np.arange(4001)[:, None] == 2, np.nan, [0.3, 0.0])
    fixes = solve_on_side(LINE_M, range_m, lab.TAG_HEIGHT_M, 0.1, 0.5, beside_m)
    assert fixes.solved[np.abs(off_m) > 1.5].mean() > 0.99
    assert fixes.solved[np.abs(off_m) < 0.1].mean() < 0.15
    far = fixes.solved & (np.abs(off_m) > 0.5)
    assert (np.sign(fixes.position_m[far] @ ACROSS) == np.sign(off_m[far])).all()
    np.testing.assert_array_equal(fixes.degenerate[:3], [False, False, True])
    pole_m = np.array([[1.0, 2.0, h] for h in (0.5, 1.5, 2.5)])
    assert solve_on_side(pole_m, lab.true_ranges(walk_left(3), pole_m), 0.6, 0.1, 0.5, "left").degenerate.all()


@pytest.mark.parametrize(("swing_m", "told"), [(0.0, False), (0.1, False), (0.3, False), (1.0, True)])
def test_heights_are_told_by_anchors_that_differ_in_height(swing_m, told):
    """Where they are, solving for them works: few degenerate epochs and no image taken for the fix."""
    anchors_m = np.array([[0, 0, 1], [8, 0, -1], [8, 7, 1], [0, 7, -1], [4, -1, 1], [4, 8, -1]], dtype=float)
    anchors_m = anchors_m * [1, 1, swing_m] + [0, 0, 1.2]
    range_m = noisy_ranges(anchors_m, 400)[1]

    def told_by(anchors_m, range_m):
        at_height = solve_fixes("gauss_newton", anchors_m, range_m, 0.6, 0.1, 0.5)
        return heights_are_told(anchors_m, at_height, 0.1)

    assert told_by(anchors_m, range_m) == told
    fixes = solve_fixes("gauss_newton", anchors_m, range_m, None, 0.1, 0.5)
    assert (fixes.solved.mean() > 0.95 and np.sum(np.abs(fixes.z_m - 0.6) < 1.0) > 380) == told
    assert not told_by(anchors_m * [20, 20, 1], noisy_ranges(anchors_m * [20, 20, 1])[1])  # too flat
    assert not told_by(anchors_m, np.where(np.arange(6) > 2, range_m, np.nan))  # three of them
    assert not told_by(anchors_m, range_m[:0])


@pytest.mark.parametrize("smooth", [True, False])
def test_anchors_on_a_line_give_the_side_that_was_asked_for_until_the_tag_crosses_it(lab, smooth):
    row_m = np.array([[0.0, 0, 1.2], [4, 0, 1.2], [9, 0, 1.2]])
    simulated = lab.simulate(lambda t_s: np.stack([2 + 0.3 * t_s, 3 - 0.45 * t_s], axis=1), row_m, seed=11)
    found = lab.locate_tag(simulated.series, row_m, calibrate=False, mirror="left", smooth=smooth)
    fixed, off_m = found.fixes.solved, found.track.position_m - simulated.truth_at(found.track.t_ns)
    assert np.median(np.hypot(*off_m[-100:].T)) < 0.2
    assert (np.hypot(*(found.fixes.position_m - simulated.position_m)[fixed].T) < 1.0).mean() > 0.98
    assert fixed.mean() > 0.5
    with pytest.raises(QuadlogError, match=r"uwb\.mirror"):
        lab.locate_tag(simulated.series, row_m)
