from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from quadlog.planning.path import (
    control_points,
    smooth_path,
    spline_point,
    straight_path,
)
from quadlog.planning.planners.astar import AStar

FREE = np.zeros((100, 100), dtype=bool)
ORIGIN_M = np.array([-3.0, 2.0])
CELL_M = 0.1


def smooth(points_m, blocked=FREE, merge_m=0.3, spacing_m=0.05):
    return smooth_path(np.asarray(points_m, dtype=float), merge_m, spacing_m, blocked, ORIGIN_M, CELL_M)


def in_map(cells):
    return (np.asarray(cells) + 0.5) * CELL_M + ORIGIN_M


def touches(curve_m, blocked, samples=400):
    """Whether a densely sampled polyline enters a blocked cell: an oracle that knows no grid walk.

    Passing exactly through a cell's corner or along its edge is no entering.
    """
    t = np.linspace(0, 1, samples)[:, None]
    points = np.concatenate([a + t * (b - a) for a, b in pairwise(curve_m)])
    in_cells = (points - ORIGIN_M) / CELL_M
    cells = np.floor(in_cells).astype(int)
    inside = np.abs(in_cells - cells - 0.5).max(axis=1) < 0.5 - 1e-9
    return blocked[cells[inside, 1], cells[inside, 0]].any()


def test_piece_equals_scipy_bspline():
    """Eq. 14 is the uniform quadratic B-spline."""
    rng = np.random.default_rng(0)
    control = rng.normal(size=(7, 2))
    knots = np.arange(10.0)
    oracle = BSpline(knots, control, 2)
    t = np.linspace(0, 1, 11)
    for i in range(5):
        ours = spline_point(control[i], control[i + 1], control[i + 2], t)
        np.testing.assert_allclose(ours, oracle(t + i + 2), atol=1e-12)


def test_smooth_path_turns_gradually_and_keeps_its_ends():
    points_m = in_map([[5, 5], [30, 5], [30, 30], [60, 60]])
    curve_m = smooth(points_m, spacing_m=0.02)
    np.testing.assert_allclose(curve_m[0], points_m[0], atol=1e-12)
    np.testing.assert_allclose(curve_m[-1], points_m[-1], atol=1e-12)
    steps = np.diff(curve_m, axis=0)
    headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    assert np.abs(np.diff(headings)).max() < 0.1  # the path itself turns by 1.57 at once
    assert np.hypot(*steps.T).max() <= 0.02 + 1e-9


@pytest.mark.parametrize("points_m", [[[0.0, 3.0]], [[0.0, 3.0], [0.0, 3.0]]])
def test_a_path_of_one_point(points_m):
    np.testing.assert_allclose(smooth(points_m), [[0.0, 3.0]])
    np.testing.assert_allclose(straight_path(np.array(points_m), 0.05), [[0.0, 3.0]])


def test_close_inflection_points_are_merged_but_not_through_obstacles():
    staircase = np.array([[i // 2, (i + 1) // 2] for i in range(20)], dtype=float) + 0.5
    merged = control_points(staircase, 3.0, FREE)
    assert len(merged) < len(control_points(staircase, 0.0, FREE))
    assert np.hypot(*np.diff(merged, axis=0).T).min() >= 3.0
    around = np.array([[0, 0], [0, 1], [0, 2], [1, 2], [2, 2], [2, 1], [2, 0]], dtype=float) + 0.5
    blocked = np.zeros((4, 4), dtype=bool)
    assert len(control_points(around, 10.0, blocked)) == 2
    blocked[0, 1] = blocked[1, 1] = True
    np.testing.assert_array_equal(control_points(around, 10.0, blocked), around[[0, 2, 4, 6]])


def test_only_the_corner_at_an_obstacle_stays_sharp():
    points_m = in_map([[5, 5], [45, 5], [45, 45], [85, 45]])
    blocked = FREE.copy()
    blocked[15:36, 34:45] = True
    blocked[6:10, 35:45] = True
    curve_m = smooth(points_m, blocked)
    assert not touches(curve_m, blocked)
    assert np.hypot(*(curve_m - points_m[1]).T).min() < 1e-9  # through the corner
    assert np.hypot(*(curve_m - points_m[2]).T).min() > 0.1  # round the other


@given(
    seed=st.integers(0, 2**32 - 1),
    merge_m=st.sampled_from([0.0, 0.3, 1.0]),
    spacing_m=st.sampled_from([0.03, 0.2, 5.0]),
)
def test_never_touches_a_blocked_cell(seed, merge_m, spacing_m):
    rng = np.random.default_rng(seed)
    blocked = rng.random((30, 30)) < rng.choice([0.05, 0.2, 0.35])
    rows, cols = np.nonzero(~blocked)
    (a, b) = rng.integers(0, len(rows), 2)
    plan = AStar().plan(blocked, (int(cols[a]), int(rows[a])), (int(cols[b]), int(rows[b])))
    if not plan.found:
        return
    points_m = in_map(plan.cells)
    points_m[0] += rng.uniform(-0.049, 0.049, 2)  # the robot stands anywhere in its cell
    curve_m = smooth(points_m, blocked, merge_m, spacing_m)
    assert np.isfinite(curve_m).all()
    np.testing.assert_allclose(curve_m[[0, -1]], points_m[[0, -1]], atol=1e-9)
    if len(curve_m) > 1:
        assert not touches(curve_m, blocked)
