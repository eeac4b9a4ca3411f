from __future__ import annotations

import numpy as np
import pytest

from quadlog.mapping.goal_projection import INFLATIONS
from quadlog.mapping.grid import window_around
from quadlog.planning.query import NO_GOAL, START_OUTSIDE, WALLED_IN, Growth, Query, make_query

CELL_M = 0.1
WINDOW = window_around(np.array([0.0, 0.0]), CELL_M, 40)


def ask(occupied=None, start=(0.03, 0.02), goal=(1.51, -0.72), growth=None):
    occupied = np.zeros(WINDOW.shape, dtype=bool) if occupied is None else occupied
    return make_query(WINDOW, occupied, np.array(start), np.array(goal), growth or Growth())


@pytest.mark.parametrize("dilation", sorted(INFLATIONS))
@pytest.mark.parametrize(("dilation_m", "cells"), [(0.0, 0), (0.1, 1), (0.3, 3)])
def test_obstacles_grow_by_whole_cells(dilation, dilation_m, cells):
    occupied = np.zeros(WINDOW.shape, dtype=bool)
    occupied[5, 30] = True
    query = ask(occupied, growth=Growth(dilation_m, dilation))
    np.testing.assert_array_equal(query.blocked, INFLATIONS[dilation](occupied, cells))
    assert not occupied[5, 31]


def test_why_there_is_nothing_to_plan():
    walls = np.ones(WINDOW.shape, dtype=bool)
    for start in ((2.05, 0.0), (0.0, -2.05), (1e9, 0.0)):
        assert ask(start=start) is START_OUTSIDE
        assert ask(walls, start=start) is START_OUTSIDE
    assert ask(walls) is WALLED_IN
    assert ask(goal=(np.nan, 0.0)) is NO_GOAL
    assert ask(goal=(0.0, np.inf)) is NO_GOAL
    assert len({each.why for each in (START_OUTSIDE, WALLED_IN, NO_GOAL)}) == 3
    assert isinstance(ask(), Query)


@pytest.mark.parametrize("start", [(np.nan, 0.0), (0.0, np.inf)])
def test_a_start_that_is_not_finite_is_an_error(start):
    with pytest.raises(ValueError, match="finite"):
        ask(start=start)
