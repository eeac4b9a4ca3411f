from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from quadlog.positioning.fix.least_squares import descend_all, invert_normal, invert_one, normal_equations
from quadlog.positioning.fix.linear import spread_of

RNG = np.random.default_rng(1)
ANCHORS_M = RNG.uniform(-6, 6, (6, 3))
RANGE_M = np.linalg.norm(ANCHORS_M - [0.5, 1.0, 0.3], axis=1) + 0.2 * RNG.standard_normal(6)


@pytest.mark.parametrize("limits", [(np.inf, np.inf), (0.1, 0.4), (0.05, 0.05)])
def test_the_gradient_is_that_of_the_cost(limits):
    """By finite differences; the cost is sum r^2, so its gradient is -2 sum w r u."""
    place_m = np.array([0.7, 0.8, 0.1])

    def cost(p):
        return normal_equations(*p, 1.0, ANCHORS_M, RANGE_M[None], 0, *limits)[9]

    normal = normal_equations(*place_m, 1.0, ANCHORS_M, RANGE_M[None], 0, *limits)
    np.testing.assert_allclose(approx_fprime(place_m, cost, 1e-7), -2 * np.array(normal[6:9]), rtol=1e-4)


def test_weights_are_hubers():
    """One range, along x: weight times residual is the limit, and the cost goes on in a straight line."""
    anchor_m = np.zeros((1, 3))
    for range_m, weight, cost in ((5.05, 1.0, 0.0025), (5.4, 0.25, 0.1 * 0.7), (4.6, 0.5, 0.2 * 0.6)):
        normal = normal_equations(5.0, 0.0, 0.0, 1.0, anchor_m, np.array([[range_m]]), 0, 0.1, 0.2)
        assert normal[0] == pytest.approx(weight)
        assert normal[6] == pytest.approx(weight * (range_m - 5))
        assert normal[9] == pytest.approx(cost)


def test_the_inverse_is_one_and_refuses_what_has_none():
    matrix = np.cov(RNG.standard_normal((3, 9)))
    ok, xx, xy, yy, xz, yz, zz = invert_normal(*matrix[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]])
    assert ok
    np.testing.assert_allclose([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], np.linalg.inv(matrix), rtol=1e-9)
    flat, none, unknown = (1.0, 1.0, 1.0, 0.0, 0.0, 1.0), (0.0,) * 6, (np.nan, 0.0, 1.0, 0.0, 0.0, 1.0)
    for entries in (flat, none, unknown):
        assert not invert_one(*entries)[0]
    one = matrix[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    with np.errstate(divide="ignore", invalid="ignore"):
        sharp, *inverse = invert_normal(*np.array([one, flat, none, unknown]).T)
    np.testing.assert_array_equal(sharp, [True, False, False, False])
    np.testing.assert_allclose([each[0] for each in inverse], invert_one(*one)[1:], rtol=1e-12)


@pytest.mark.parametrize("unknowns", [2, 3])
def test_spread_is_the_distance_from_the_plane_that_fits_best(unknowns):
    flat_m = RNG.uniform(-5, 5, (7, 3))
    flat_m[:, unknowns - 1] *= 0.004
    known_m = flat_m[:, :unknowns] - flat_m[:, :unknowns].mean(axis=0)
    expected_m2 = np.linalg.svd(known_m, compute_uv=False)[-1] ** 2 / 7
    heard = np.ones((3, 7), dtype=bool)
    heard[1, 5:] = heard[2, 1:] = False
    found_m2 = spread_of(flat_m, heard, unknowns == 3)
    assert found_m2[0] == pytest.approx(expected_m2, rel=1e-4)
    alone_m2 = spread_of(flat_m[:5], np.ones((1, 5), dtype=bool), unknowns == 3)
    assert found_m2[1] == pytest.approx(alone_m2[0], rel=1e-9)
    assert found_m2[2] == 0
    assert not spread_of(flat_m * 0, heard, unknowns == 3).any()


def test_a_frozen_height_stays(lab):
    start_m = np.array([[0.0, 0.0, 0.6], [np.nan, 0.0, 0.6]])
    position_m, inverse, cost_m2 = descend_all(ANCHORS_M, np.tile(RANGE_M, (2, 1)), start_m, False, np.inf, np.inf)
    assert position_m[0, 2] == 0.6
    assert inverse.shape == (2, 2, 2)
    assert np.isnan(position_m[1]).all()
    assert cost_m2[1] == np.inf
