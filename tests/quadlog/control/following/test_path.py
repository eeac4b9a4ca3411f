from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadlog.control.following.path import lookahead_point, nearest_on_path, remaining_length

CORNER = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]])


def test_sides_have_signs():
    left, right = nearest_on_path(CORNER, 1.0, 0.5), nearest_on_path(CORNER, 1.0, -0.5)
    assert (left.x_m, left.y_m, left.distance_m) == (1.0, 0.0, 0.5)
    assert right.distance_m == -0.5
    up = nearest_on_path(CORNER, 4.5, 2.0)
    assert (up.segment, up.distance_m) == (1, -0.5)
    assert up.heading_rad == pytest.approx(math.pi / 2)


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_nearest_against_dense_samples(seed):
    rng = np.random.default_rng(seed)
    path = rng.uniform(-2, 2, (5, 2)).repeat(rng.integers(1, 3, 5), axis=0)
    x, y = rng.uniform(-3, 3, 2)
    near = nearest_on_path(path, x, y)
    t = np.linspace(0, 1, 2001)[:, None]
    samples = np.concatenate([a + t * (b - a) for a, b in pairwise(path)])
    nearest = np.hypot(*(samples - [x, y]).T).min()
    assert abs(near.distance_m) <= nearest + 1e-12
    assert abs(near.distance_m) == pytest.approx(nearest, abs=2e-3)
    assert math.hypot(near.x_m - x, near.y_m - y) == pytest.approx(abs(near.distance_m))


def test_one_point_and_repeated_points():
    point = np.array([[1.0, 1.0]])
    near = nearest_on_path(point, 4.0, 5.0)
    assert abs(near.distance_m) == 5.0
    assert math.isnan(near.heading_rad)
    assert lookahead_point(point, 4.0, 5.0, near, 1.0) == (1.0, 1.0)
    assert remaining_length(point, 0, 0.0) == 0.0
    repeated = np.array([[0.0, 0.0], [0.0, 0.0], [2.0, 0.0], [2.0, 0.0]])
    near = nearest_on_path(repeated, 2.5, 0.0)
    assert near.heading_rad == 0.0
    assert near.distance_m == 0.5
    assert remaining_length(repeated, near.segment, near.fraction) == 0.0


def test_lookahead_point_is_where_the_circle_meets_the_path_ahead():
    x, y = 1.0, 0.5
    near = nearest_on_path(CORNER, x, y)
    ahead = lookahead_point(CORNER, x, y, near, 2.0)
    assert ahead == pytest.approx((1.0 + math.sqrt(4 - 0.25), 0.0))
    around = lookahead_point(CORNER, x, y, near, 3.5)
    assert math.dist(around, (x, y)) == pytest.approx(3.5)
    assert around[0] == 4.0
    assert lookahead_point(CORNER, x, y, near, 50.0) == (4.0, 3.0)
    far = nearest_on_path(CORNER, 1.0, 5.0)
    assert lookahead_point(CORNER, 1.0, 5.0, far, 0.5) == (far.x_m, far.y_m)
