from __future__ import annotations

import numpy as np
import pytest

from quadlog.positioning.fix.ambiguity import descend_both_sides, reflect_places
from quadlog.positioning.fix.least_squares import descend_all
from quadlog.positioning.fix.trilateration import solve_gauss_newton


def zigzag(off_m: float) -> np.ndarray:
    return np.array([[0.0, off_m, 1.2], [3.0, -off_m, 1.2], [6.0, off_m, 1.2], [9.0, -off_m, 1.2]])


def noisy_ranges(lab, anchors_m, seed, n=5000):
    rng = np.random.default_rng(seed)
    place_m = np.column_stack([rng.uniform(0, 8, n), rng.uniform(1, 6, n)])
    return place_m, lab.true_ranges(place_m, anchors_m) + 0.1 * rng.standard_normal((n, len(anchors_m)))


@pytest.mark.parametrize(("off_m", "share"), [(0.06, 0.2), (0.2, 0.98), (1.0, 1.0)])
def test_anchors_near_a_line_solve_only_what_has_no_image(lab, off_m, share):
    """The nearer to a line, the fewer epochs have a fix; but those they have are on the right side (linear fixes at
    0.06 m: 79 of 100).
    """
    anchors_m = zigzag(off_m)
    _, range_m = noisy_ranges(lab, anchors_m, 1)
    fixes = solve_gauss_newton(anchors_m, range_m, lab.TAG_HEIGHT_M, 0.1, 0.5)
    assert share / 10 < fixes.solved.mean() <= share
    assert np.mean(fixes.position_m[fixes.solved, 1] < 0) < 0.1
    np.testing.assert_array_equal(fixes.degenerate, ~fixes.solved)


@pytest.mark.parametrize("solve_z", [False, True])
def test_the_better_of_two_images_is_taken_wherever_the_start(lab, solve_z):
    """A descent alone ends in the image when it starts there."""
    anchors_m = zigzag(0.5)
    if solve_z:
        anchors_m = np.array([[0, 0, 1.5], [8, 0, 0.9], [8, 7, 1.5], [0, 7, 0.9]], dtype=float)
    place_m = np.array([[3.0, 4.0, -1.0]])
    range_m = np.linalg.norm(place_m[:, None] - anchors_m, axis=2)
    image_m = reflect_places(anchors_m, np.ones((1, 4), dtype=bool), place_m, 3 if solve_z else 2)
    alone_m, _, _ = descend_all(anchors_m, range_m, image_m, solve_z, np.inf, np.inf)
    assert np.linalg.norm(alone_m - place_m) > 1
    for start_m in (place_m + 0.1 * np.array([1, 1, solve_z]), image_m):
        found_m, inverse = descend_both_sides(anchors_m, range_m, start_m, solve_z, 0.05, np.inf, np.inf)
        np.testing.assert_allclose(found_m, place_m, atol=1e-5)
        assert np.isfinite(inverse).all()


def test_ellipses_stay_honest_near_a_line(lab):
    anchors_m = zigzag(0.6)
    place_m, range_m = noisy_ranges(lab, anchors_m, 2)
    fixes = solve_gauss_newton(anchors_m, range_m, lab.TAG_HEIGHT_M, 0.1, 0.5)
    error_m = (fixes.position_m - place_m)[fixes.solved]
    assert fixes.solved.mean() > 0.99
    assert 0.94 < lab.share_in_ellipses(error_m, fixes.covariance_m2[fixes.solved]) < 0.96


@pytest.mark.parametrize("unknowns", [2, 3])
def test_reflections_are_as_far_from_anchors_in_the_plane(unknowns):
    rng = np.random.default_rng(3)
    anchors_m = rng.uniform(-5, 5, (5, 3))
    normal = np.array([0.6, 0.8, 0.0]) if unknowns == 2 else np.array([1.0, -2.0, 3.0]) / np.sqrt(14)
    anchors_m -= ((anchors_m - 1.0) @ normal)[:, None] * normal
    heard = np.ones((4, 5), dtype=bool)
    heard[1, 0] = heard[2, 1:] = False
    place_m = rng.uniform(-5, 5, (4, 3))
    image_m = reflect_places(anchors_m, heard, place_m, unknowns)
    assert np.isnan(image_m[2]).all()
    seen = [0, 1, 3]
    np.testing.assert_allclose(
        np.linalg.norm(image_m[seen, None] - anchors_m, axis=2),
        np.linalg.norm(place_m[seen, None] - anchors_m, axis=2),
    )
    assert np.linalg.norm(image_m[seen] - place_m[seen], axis=1).min() > 0.1
