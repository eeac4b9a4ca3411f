from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from quadlog.control.following.path import (
    LEAST_CHORD_M,
    FreeSpace,
    lookahead,
    nearest_on_path,
)

CORNER = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]])
ORIGIN_M, CELL_M = (-1.0, -1.0), 0.1


def block(x0_m, y0_m, x1_m, y1_m):
    """Free space from (-1, -1) to (5, 5) but for a rectangle."""
    centres_m = ORIGIN_M[0] + CELL_M * (np.arange(60) + 0.5)
    x_m, y_m = np.meshgrid(centres_m, centres_m)
    return FreeSpace((x_m > x0_m) & (x_m < x1_m) & (y_m > y0_m) & (y_m < y1_m), ORIGIN_M, CELL_M)


def aim(x_m, y_m, lookahead_m, space):
    near = nearest_on_path(CORNER, x_m, y_m)
    return lookahead(CORNER, x_m, y_m, near, lookahead_m, math.inf, space)


def test_a_wall_in_the_corner_ends_the_look_ahead_where_the_line_of_sight_touches_it():
    """From (0, 0) the wall's corner (3, 0.3) hides what lies above (4, 0.4)."""
    wall = block(2.0, 0.3, 3.0, 3.0)
    x_m, y_m, along_m = aim(0.0, 0.0, 4.5, wall)
    assert x_m == 4.0
    assert 0.4 - CELL_M / 2 <= y_m <= 0.4
    assert along_m == pytest.approx(4.0 + y_m)
    # Nearer than that, and once it is round the corner, nothing changes.
    for place in ((0.0, 0.0, 3.0), (3.8, 0.0, 2.0)):
        near = nearest_on_path(CORNER, *place[:2])
        assert aim(*place, wall) == lookahead(CORNER, *place[:2], near, place[2], math.inf)


@example(seed=56170396)  # nothing ahead is in sight: the point is the nearest one, but for rounding
@given(seed=st.integers(0, 2**32 - 1))
def test_the_chord_is_free_and_no_longer_than_asked(seed):
    rng = np.random.default_rng(seed)
    blocked = rng.random((60, 60)) < rng.choice([0.0, 0.01, 0.05])
    space = FreeSpace(blocked, ORIGIN_M, CELL_M)
    path, (x_m, y_m) = rng.uniform(-0.9, 4.9, (5, 2)), rng.uniform(-0.9, 4.9, 2)
    lookahead_m = rng.uniform(0.1, 4.0)
    near = nearest_on_path(path, x_m, y_m)
    plain = lookahead(path, x_m, y_m, near, lookahead_m, 3.0)
    found = lookahead(path, x_m, y_m, near, lookahead_m, 3.0, space)
    assert found[2] <= plain[2]
    if not blocked.any():
        assert found == plain
    chord_m = np.linspace((x_m, y_m), found[:2], 2000)
    cells = np.floor((chord_m - ORIGIN_M) / CELL_M).astype(int)
    if found[2] > 1e-9 and math.dist(found[:2], (x_m, y_m)) > LEAST_CHORD_M:
        assert not blocked[cells[:, 1], cells[:, 0]].any()
