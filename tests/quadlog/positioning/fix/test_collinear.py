from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from quadlog.positioning.fix.ambiguity import solve_on_side, start_on_side
from quadlog.positioning.fix.trilateration import solve_gauss_newton

LINE_M = np.array([[0.0, 0.0, 1.2], [3.0, 1.0, 1.2], [6.0, 2.0, 1.4], [9.0, 3.0, 1.0]])
ACROSS = np.array([-1.0, 3.0]) / np.sqrt(10)
STD_M = 0.1


def mirrored(place_m):
    return place_m - 2 * (place_m @ ACROSS)[:, None] * ACROSS


def noisy_ranges(lab, place_m, seed, std_m=STD_M):
    rng = np.random.default_rng(seed)
    return lab.true_ranges(place_m, LINE_M) + std_m * rng.standard_normal((len(place_m), 4))


def walk_left(n=5000):
    t = np.linspace(0, 2 * np.pi, n)
    return np.column_stack([4 + 3 * np.cos(t), 5.5 + 1.5 * np.sin(2 * t)])


def test_each_side_has_the_fix_and_its_image(lab):
    place_m = walk_left(40)
    range_m = noisy_ranges(lab, place_m, 0, 0.0)
    for side, truth_m in (("left", place_m), ("right", mirrored(place_m))):
        start_m = start_on_side(LINE_M, range_m, lab.TAG_HEIGHT_M, STD_M, side)
        np.testing.assert_allclose(start_m, truth_m, atol=1e-9)
        fixes = solve_on_side(LINE_M, range_m, lab.TAG_HEIGHT_M, STD_M, 0.5, start_m)
        np.testing.assert_allclose(fixes.position_m, truth_m, atol=1e-6)
    backwards = start_on_side(LINE_M[::-1], range_m[:, ::-1], lab.TAG_HEIGHT_M, STD_M, "right")
    np.testing.assert_allclose(backwards, place_m, atol=1e-9)


@pytest.mark.parametrize("order", list(permutations(range(4))))
def test_sides_are_those_of_the_way_from_the_first_anchor_to_the_last(lab, order):
    line_m, range_m = LINE_M[list(order)], noisy_ranges(lab, walk_left(10), 0, 0.0)[:, list(order)]
    side = "left" if order[0] < order[-1] else "right"
    start_m = start_on_side(line_m, range_m, lab.TAG_HEIGHT_M, STD_M, side)
    np.testing.assert_allclose(start_m, walk_left(10), atol=1e-9)


def test_a_fix_is_on_the_side_of_its_start_or_is_none(lab):
    """From starts all over the place, 18 in 100 000 descents cross the line."""
    rng = np.random.default_rng(5)
    along = np.array([3.0, 1.0]) / np.sqrt(10)
    place_m, start_m = (
        rng.uniform(-6, 14, (100_000, 1)) * along + rng.uniform(0.1, 10, (100_000, 1)) * ACROSS for _ in range(2)
    )
    range_m = noisy_ranges(lab, place_m, 6)
    fixes = solve_on_side(LINE_M, range_m, lab.TAG_HEIGHT_M, STD_M, 0.5, start_m)
    assert fixes.solved.mean() > 0.9
    assert (fixes.position_m[fixes.solved] @ ACROSS > 0).all()


def test_without_being_asked_they_are_degenerate(lab):
    fixes = solve_gauss_newton(LINE_M, noisy_ranges(lab, walk_left(40), 1), lab.TAG_HEIGHT_M, STD_M, 0.5)
    assert fixes.degenerate.all()


def test_the_chosen_side_is_as_good_as_the_geometry_allows(lab):
    place_m = walk_left(20_000)
    range_m = noisy_ranges(lab, place_m, 2)
    start_m = start_on_side(LINE_M, range_m, lab.TAG_HEIGHT_M, STD_M, "left")
    fixes = solve_on_side(LINE_M, range_m, lab.TAG_HEIGHT_M, STD_M, 0.5, start_m)
    assert fixes.solved.mean() > 0.999
    error_m = (fixes.position_m - place_m)[fixes.solved]
    assert lab.rmse(error_m) == pytest.approx(STD_M * np.sqrt((fixes.hdop[fixes.solved] ** 2).mean()), rel=0.03)
    assert 0.94 < lab.share_in_ellipses(error_m, fixes.covariance_m2[fixes.solved]) < 0.96


def test_a_track_carries_its_side_across_the_line(lab):
    """Starts are the truth 0.3 m off: the side is told by them, except near the line, where nothing tells it."""
    t = np.linspace(-1, 1, 4001)
    place_m = np.array([4.5, 1.5]) + 4 * t[:, None] * ACROSS
    range_m = noisy_ranges(lab, place_m, 3)
    fixes = solve_on_side(LINE_M, range_m, lab.TAG_HEIGHT_M, STD_M, 0.5, place_m + np.array([0.3, 0.0]))
    off_m = place_m @ ACROSS
    assert fixes.solved[np.abs(off_m) > 1.5].mean() > 0.99
    assert fixes.solved[np.abs(off_m) < 0.1].mean() < 0.15
    np.testing.assert_array_equal(fixes.degenerate, ~fixes.solved)
    far = fixes.solved & (np.abs(off_m) > 0.5)
    assert (np.sign(fixes.position_m[far] @ ACROSS) == np.sign(off_m[far])).all()


def test_what_has_no_start_or_too_few_ranges_is_not_solved(lab):
    place_m = walk_left(4)
    range_m = noisy_ranges(lab, place_m, 4)
    range_m[1, 2:] = np.nan
    start_m = start_on_side(LINE_M, range_m, lab.TAG_HEIGHT_M, STD_M, "left")
    assert np.isnan(start_m[1]).all()
    start_m[1] = place_m[1]
    start_m[2] = np.nan
    fixes = solve_on_side(LINE_M, range_m, lab.TAG_HEIGHT_M, STD_M, 0.5, start_m)
    np.testing.assert_array_equal(fixes.solved, [True, False, False, True])
    np.testing.assert_array_equal(fixes.degenerate, [False, False, True, False])


def test_anchors_over_one_spot_give_nothing(lab):
    pole_m = np.array([[1.0, 2.0, h] for h in (0.5, 1.5, 2.5)])
    range_m = lab.true_ranges(walk_left(3), pole_m)
    start_m = start_on_side(pole_m, range_m, lab.TAG_HEIGHT_M, STD_M, "left")
    assert solve_on_side(pole_m, range_m, lab.TAG_HEIGHT_M, STD_M, 0.5, start_m).degenerate.all()
