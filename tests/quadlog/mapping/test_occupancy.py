from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadlog.mapping.occupancy import obstacle_tops
from quadlog.mapping.window import Window


def occupancy(points: np.ndarray, window: Window, min_points: int) -> np.ndarray:
    return np.isfinite(obstacle_tops(np.column_stack([points, np.ones(len(points))]), window, min_points))


@settings(deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 4), st.integers(-40, 40), st.integers(-40, 40))
def test_agrees_with_numpys_histogram(seed: int, min_points: int, col0: int, row0: int) -> None:
    window = Window(col0, row0, 0.25, (7, 11))
    points = np.random.default_rng(seed).uniform(-12, 12, (3000, 2))
    edges = [window.origin_m[axis] + 0.25 * np.arange(size + 1) for axis, size in ((1, 7), (0, 11))]
    expected, _, _ = np.histogram2d(points[:, 1], points[:, 0], bins=edges)
    assert (occupancy(points, window, min_points) == (expected >= min_points)).all()


def test_row_is_y_and_col_is_x() -> None:
    occupied = occupancy(np.array([[0.35, 0.05]]), Window(0, 0, 0.1, (2, 5)), 1)
    assert np.argwhere(occupied).tolist() == [[0, 3]]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30, -1e300])
def test_points_that_are_nowhere_count_nowhere(bad: float) -> None:
    points = np.array([[bad, 0.0], [0.0, bad], [bad, bad]])
    assert not occupancy(points, Window(-5, -5, 0.1, (10, 10)), 1).any()
    assert not occupancy(np.empty((0, 2)), Window(-5, -5, 0.1, (10, 10)), 1).any()


def test_the_highest_point_of_a_cell_is_its_top() -> None:
    points = np.array([[0.05, 0.05, 0.3], [0.06, 0.01, 1.2], [0.02, 0.03, 0.7], [0.15, 0.05, 0.4]])
    assert obstacle_tops(points, Window(0, 0, 0.1, (1, 3)), 1).tolist() == [pytest.approx([1.2, 0.4, -np.inf])]
    assert obstacle_tops(points, Window(0, 0, 0.1, (1, 3)), 2).tolist() == [pytest.approx([1.2, -np.inf, -np.inf])]
