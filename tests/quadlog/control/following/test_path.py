from __future__ import annotations

import math

import numpy as np
import pytest

from quadlog.control.following.path import lookahead_within, nearest_on_path

CORNER = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]])


def ahead_of(path, x, y, near, lookahead_m):
    return lookahead_within(path, x, y, near, lookahead_m, math.inf)[:2]


def test_lookahead_point_is_where_the_circle_meets_the_path_ahead():
    x, y = 1.0, 0.5
    near = nearest_on_path(CORNER, x, y)
    ahead = ahead_of(CORNER, x, y, near, 2.0)
    assert ahead == pytest.approx((1.0 + math.sqrt(4 - 0.25), 0.0))
    around = ahead_of(CORNER, x, y, near, 3.5)
    assert math.dist(around, (x, y)) == pytest.approx(3.5)
    assert around[0] == 4.0
    assert ahead_of(CORNER, x, y, near, 50.0) == (4.0, 3.0)
    far = nearest_on_path(CORNER, 1.0, 5.0)
    assert ahead_of(CORNER, 1.0, 5.0, far, 0.5) == (far.x_m, far.y_m)
