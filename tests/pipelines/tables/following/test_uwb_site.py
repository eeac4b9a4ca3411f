from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from quadlog.pipelines.tables.following.uwb_ranges import (
    BOX_HIGH_M,
    BOX_LOW_M,
    PERSON,
    RANGE_STD_M,
    ROBOT,
    STATIONS_M,
    TAGS,
    cramer_rao,
    distances,
    draw_ranges,
    height_group,
    truth_group,
)
from quadlog.results.papers.table import PaperRow, RowGroup


def test_the_experiment_is_the_papers():
    """From its text: stations, printed tags and the six distances."""
    np.testing.assert_array_equal(STATIONS_M[:, :2], [[0, -2.4], [0, 1.6], [6, 0]])
    assert (ROBOT.printed_m, PERSON.printed_m) == ((0.0, 2.4), (0.0, 0.8))
    assert (ROBOT.true_m, PERSON.true_m) == ((0.8, 0.0), (2.4, 0.0))
    assert (ROBOT.distance_m, PERSON.distance_m) == ((2.53, 1.79, 5.20), (3.39, 2.88, 3.55))


def test_distances_are_pythagoras():
    place_m = np.array([[3.0, 1.6], [6.0, 0.0]])
    np.testing.assert_allclose(distances(place_m, STATIONS_M), [[5, 3, 3.4], [41.76**0.5, 38.56**0.5, 0]])
    raised_m = np.array([[3.0, 4.0, 12.0]])
    assert distances(np.zeros((1, 2)), raised_m)[0, 0] == 13


@pytest.mark.parametrize("n", [3, 4, 5, 8])
def test_the_bound_in_the_middle_of_a_regular_polygon_is_known(n):
    """There sum u u^T = n/2 I."""
    angle = 2 * np.pi * np.arange(n) / n
    anchors_m = np.column_stack([7 * np.cos(angle), 7 * np.sin(angle), np.zeros(n)])
    expected = RANGE_STD_M**2 * 2 / n * np.eye(2)
    np.testing.assert_allclose(cramer_rao(np.zeros((1, 2)), anchors_m)[0], expected, atol=1e-15)


@pytest.mark.parametrize("tag", TAGS)
def test_the_bound_is_the_inverse_of_the_fisher_information_by_finite_differences(tag):
    h = 1e-6
    place_m = np.array(tag.true_m)
    slopes = [
        (distances((place_m + step)[None], STATIONS_M) - distances((place_m - step)[None], STATIONS_M))[0] / (2 * h)
        for step in h * np.eye(2)
    ]
    fisher = np.array(slopes) @ np.array(slopes).T / RANGE_STD_M**2
    np.testing.assert_allclose(cramer_rao(place_m[None], STATIONS_M)[0], np.linalg.inv(fisher), rtol=1e-6)


def test_ranges_err_with_the_std_and_without_bias():
    place_m = np.random.default_rng(0).uniform(BOX_LOW_M, BOX_HIGH_M, (20_000, 2))
    error_m = draw_ranges(place_m, STATIONS_M, np.random.default_rng(1)) - distances(place_m, STATIONS_M)
    assert error_m.std() == pytest.approx(RANGE_STD_M, rel=0.01)
    assert abs(error_m.mean()) < 0.002
    assert np.abs(np.corrcoef(error_m.T) - np.eye(3)).max() < 0.03


def row(group: RowGroup, *words: str) -> PaperRow:
    (found,) = [each for each in group.rows if all(word in each.quantity for word in words)]
    return found


@pytest.mark.parametrize("tag", TAGS)
def test_the_fitted_truths_are_scipys(tag):
    def misses(place_m):
        return np.linalg.norm(place_m - STATIONS_M[:, :2], axis=1) - tag.distance_m

    fitted_m = least_squares(misses, [1.0, 0.5], xtol=1e-14).x
    group = truth_group()
    for axis, name in enumerate("xy"):
        got = row(group, f"{tag.name} tag, {name} (m)")
        assert got.paper == tag.printed_m[axis]
        assert got.ours == pytest.approx(fitted_m[axis], abs=2e-6)
        assert got.reproduces == "no"
        assert "Erratum" in got.note


def test_the_cost_of_a_forgotten_height_is_scipys():
    """At one place, by an optimizer we did not write."""
    place_m = np.array([3.0, 0.5])
    slant_m = np.hypot(np.linalg.norm(place_m - STATIONS_M[:, :2], axis=1), 0.6)
    fitted_m = least_squares(lambda p: np.linalg.norm(p - STATIONS_M[:, :2], axis=1) - slant_m, place_m).x
    off_m = np.linalg.norm(fitted_m - place_m)
    assert 0.01 < off_m < row(height_group(), "height ignored, Gauss-Newton", "largest").ours
