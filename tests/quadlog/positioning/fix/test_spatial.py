from __future__ import annotations

import numpy as np
import pytest

from quadlog.positioning.fix.ambiguity import height_std_m, heights_are_told, mirror_apart_std
from quadlog.positioning.fix.trilateration import solve_gauss_newton

HALL_M = np.array([[0, 0, 0.3], [8, 0, 2.6], [8, 7, 0.4], [0, 7, 2.5], [4, 0, 2.8], [4, 7, 0.2]], dtype=float)
LEVEL_M = HALL_M * [1, 1, 0] + [[0, 0, 1.0442 + 0.002 * (i % 3)] for i in range(6)]


def places(n=400, seed=1):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(1, 7, n), rng.uniform(1, 6, n)])


def test_height_std_is_the_bound():
    place_m = places(20)
    heard = np.ones((20, 6), dtype=bool)
    heard[:10, 0] = False
    std_m = height_std_m(HALL_M, place_m, 1.0, heard, 0.1)
    for i in range(20):
        unit = np.append(place_m[i], 1.0) - HALL_M[heard[i]]
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
        assert std_m[i] == pytest.approx(0.1 * np.sqrt(np.linalg.inv(unit.T @ unit)[2, 2]), rel=1e-9)


def test_no_height_without_four_ranges_or_in_the_anchors_plane():
    place_m = places(3)
    heard = np.ones((3, 6), dtype=bool)
    heard[1, 3:] = False
    np.testing.assert_array_equal(np.isfinite(height_std_m(HALL_M, place_m, 1.0, heard, 0.1)), [True, False, True])
    assert np.isinf(height_std_m(HALL_M * [1, 1, 0], place_m, 0.0, heard, 0.1)).all()


def test_the_mirror_image_of_level_anchors_fits_as_well():
    heard = np.ones((400, 6), dtype=bool)
    assert mirror_apart_std(HALL_M * [1, 1, 0], places(), 0.6, heard, 0.1).max() < 1e-3
    assert mirror_apart_std(LEVEL_M, places(), 0.6, heard, 0.1).max() < 0.1
    assert mirror_apart_std(HALL_M, places(), 0.6, heard, 0.1).min() > 6


@pytest.mark.parametrize(("swing_m", "told"), [(0.0, False), (0.1, False), (0.3, False), (1.0, True)])
def test_heights_are_told_by_anchors_that_differ_in_height(swing_m, told):
    """Where they are, solving for them works: few degenerate epochs and no image taken for the fix."""
    anchors_m = np.array([[0, 0, 1], [8, 0, -1], [8, 7, 1], [0, 7, -1], [4, -1, 1], [4, 8, -1]], dtype=float)
    anchors_m = anchors_m * [1, 1, swing_m] + [0, 0, 1.2]
    heard = np.ones((400, 6), dtype=bool)
    assert heights_are_told(anchors_m, places(), 0.3, heard, 0.1) == told
    range_m = np.linalg.norm(np.column_stack([places(), np.full(400, 0.3)])[:, None] - anchors_m, axis=2)
    range_m += 0.1 * np.random.default_rng(2).standard_normal(range_m.shape)
    fixes = solve_gauss_newton(anchors_m, range_m, None, 0.1, 0.5)
    assert (fixes.solved.mean() > 0.95) == told
    assert (np.sum(np.abs(fixes.z_m - 0.3) < 1.0) > 380) == told


def test_heights_are_not_told_by_far_anchors_or_by_nothing():
    """The trolley's room: all anchors within 2 mm of one height. Then anchors far away, below and above: too flat."""
    heard = np.ones((400, 6), dtype=bool)
    assert not heights_are_told(LEVEL_M, places(), 0.97, heard, 0.1)
    assert not heights_are_told(HALL_M * [20, 20, 1], 20 * places(), 1.0, heard, 0.1)
    assert not heights_are_told(HALL_M, np.full((400, 2), np.nan), 1.0, heard, 0.1)
    heard[:, :3] = False
    assert not heights_are_told(HALL_M, places(), 1.0, heard, 0.1)
