from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.distance import cdist

from quadlog.mapping.goal_projection import DETOUR, escape_start, inflate, inflate_square, project_goal
from quadlog.mapping.grid import Window

WINDOW = Window(-20, 35, 0.1, (40, 60))


@st.composite
def grids(draw: st.DrawFn) -> np.ndarray:
    """Grids from empty to nearly full, so that pockets form which cannot be reached."""
    shape = (draw(st.integers(1, 20)), draw(st.integers(1, 20)))
    return np.random.default_rng(draw(st.integers(0, 2**32))).random(shape) < draw(st.floats(0, 0.8))


def costs_by_scipy(occupied: np.ndarray, start: tuple[int, int]) -> np.ndarray:
    """Of 8-connected steps that cut no corner, infinite where there is no way, by scipy's search of a graph."""
    rows, cols = occupied.shape
    steps = []
    for row, col in np.ndindex(rows, cols):
        for dr, dc in ((a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b):
            r, c = row + dr, col + dc
            inside = 0 <= r < rows and 0 <= c < cols
            if inside and not occupied[r, c] and not (dr and dc and (occupied[row, c] or occupied[r, col])):
                steps.append((row * cols + col, r * cols + c, 14 if dr and dc else 10))
    steps = np.array(steps, dtype=np.int64).reshape(-1, 3)
    graph = coo_matrix((steps[:, 2], (steps[:, 0], steps[:, 1])), shape=(rows * cols, rows * cols))
    return dijkstra(graph.tocsr(), indices=start[1] * cols + start[0]).reshape(rows, cols)


def walked(path: np.ndarray) -> int:
    return sum(14 if step.all() else 10 for step in np.diff(path.astype(np.int64), axis=0) != 0)


@given(grids(), st.data())
def test_projection_is_reachable_and_the_nearest_such_cell(blocked: np.ndarray, data: st.DataObject) -> None:
    rows, cols = blocked.shape
    window = Window(data.draw(st.integers(-50, 50)), data.draw(st.integers(-50, 50)), 0.1, (rows, cols))
    start = (data.draw(st.integers(0, cols - 1)), data.draw(st.integers(0, rows - 1)))
    blocked[start[1], start[0]] = False
    goal_cell = np.array([data.draw(st.integers(-30, cols + 30)), data.draw(st.integers(-30, rows + 30))])

    projection = project_goal(blocked, window, start, window.centre_of(goal_cell))

    assert projection is not None
    col, row = projection.cell
    reachable = np.isfinite(costs_by_scipy(blocked, start))
    assert reachable[row, col]
    assert projection.projected == ((col, row) != tuple(goal_cell))
    if window.contains(goal_cell):
        away = ((np.argwhere(reachable)[:, ::-1] - goal_cell) ** 2).sum(axis=1)
        assert ((np.array([col, row]) - goal_cell) ** 2).sum() == away.min()
    else:
        edge = np.zeros_like(blocked)
        edge[[0, -1]] = edge[:, [0, -1]] = True
        assert edge[row, col] or not (edge & reachable).any()


def test_goal_beyond_the_window_is_where_the_line_leaves_it() -> None:
    free = np.zeros((40, 60), dtype=np.bool_)
    for goal_cell, expected in (
        ((130, 20), (59, 20)),
        ((-70, 20), (0, 20)),
        ((30, 1020), (30, 39)),
        ((30, -500), (30, 0)),
        ((130, 118), (50, 39)),
    ):
        goal = WINDOW.centre_of(np.array(goal_cell))
        assert project_goal(free, WINDOW, (30, 20), goal) == (expected, True)


def test_blocked_crossing_is_left_along_the_margin() -> None:
    blocked = np.zeros((40, 60), dtype=np.bool_)
    blocked[15:24, 59] = True  # the crossing is (59, 20): five cells up are blocked, six down
    goal = WINDOW.centre_of(np.array([130, 20]))
    assert project_goal(blocked, WINDOW, (30, 20), goal) == ((59, 24), True)
    blocked[24:26, 59] = True  # now six each way: counter-clockwise is up here
    assert project_goal(blocked, WINDOW, (30, 20), goal) == ((59, 26), True)
    blocked[26:, 59] = True
    assert project_goal(blocked, WINDOW, (30, 20), goal) == ((59, 14), True)


def test_invalid_starts_and_goals_give_none() -> None:
    blocked = np.zeros((40, 60), dtype=np.bool_)
    blocked[20, 30] = True
    goal = WINDOW.centre_of(np.array([3, 3]))
    assert project_goal(blocked, WINDOW, (30, 20), goal) is None
    assert project_goal(blocked, WINDOW, (60, 20), goal) is None
    assert project_goal(blocked, WINDOW, (3, 4), np.array([np.nan, 0.0])) is None


def test_goal_at_the_far_end_of_the_world() -> None:
    free = np.zeros((40, 60), dtype=np.bool_)
    assert project_goal(free, WINDOW, (30, 20), np.array([1e300, 5.55])) == ((59, 20), True)


@given(st.integers(0, 2**32), st.integers(1, 15), st.integers(1, 15), st.floats(0, 0.3), st.floats(0, 4))
def test_agrees_with_scipys_dijkstra(seed: int, rows: int, cols: int, share: float, radius: float) -> None:
    random = np.random.default_rng(seed)
    occupied = random.random((rows, cols)) < share
    blocked = inflate(occupied, radius)
    start = (int(random.integers(cols)), int(random.integers(rows)))

    escape = escape_start(occupied, blocked, start)

    cost = np.where(blocked, np.inf, costs_by_scipy(occupied, start))
    if escape is None:
        assert np.isinf(cost).all()
        return
    assert escape.path.dtype == np.int32
    assert tuple(escape.path[0]) == start
    assert tuple(escape.path[-1]) == escape.cell
    assert not blocked[escape.cell[1], escape.cell[0]]
    assert not occupied[escape.path[1:, 1], escape.path[1:, 0]].any()
    steps = np.abs(np.diff(escape.path.astype(np.int64), axis=0))
    assert (steps.max(axis=1, initial=0) == 1).all()
    assert walked(escape.path) == cost.min()


def test_walled_in_or_outside_is_none() -> None:
    occupied = np.ones((5, 5), dtype=np.bool_)
    occupied[2, 2] = False
    assert escape_start(occupied, np.ones((5, 5), dtype=np.bool_), (2, 2)) is None
    assert escape_start(occupied, occupied, (5, 2)) is None
    assert escape_start(occupied, occupied, (-1, 2)) is None


@given(st.integers(0, 2**32), st.integers(1, 15), st.integers(1, 15), st.floats(0, 0.2), st.floats(1, 4))
def test_towards_a_goal_it_takes_the_shortest_way_there_within_a_detour(seed, rows, cols, share, radius) -> None:
    random = np.random.default_rng(seed)
    occupied = random.random((rows, cols)) < share
    blocked = inflate(occupied, radius)
    start = (int(random.integers(cols)), int(random.integers(rows)))
    goal = (int(random.integers(-5, 20)), int(random.integers(-5, 20)))
    escape = escape_start(occupied, blocked, start, goal)
    nearest = escape_start(occupied, blocked, start)
    assert (escape is None) == (nearest is None)
    if escape is None or nearest is None:
        return
    assert not blocked[escape.cell[1], escape.cell[0]]
    assert not occupied[escape.path[1:, 1], escape.path[1:, 0]].any()
    # All but the last cell lie in the growth: it leaves it once.
    assert blocked[escape.path[:-1, 1], escape.path[:-1, 0]].all()

    away = np.abs(np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1) - goal)
    on = 10 * (away.max(axis=-1) - away.min(axis=-1)) + 14 * away.min(axis=-1)
    cost = np.where(blocked, np.inf, costs_by_scipy(occupied, start))
    least = cost.min()

    assert walked(escape.path) <= least + DETOUR
    assert walked(escape.path) + on[escape.cell[1], escape.cell[0]] <= least + on[nearest.cell[1], nearest.cell[0]]


occupied_grids = arrays(np.bool_, st.tuples(st.integers(1, 30), st.integers(1, 30)))


@given(occupied_grids, st.one_of(st.floats(0, 12), st.integers(0, 12).map(float)))
def test_euclidean_is_the_distance_to_the_nearest_occupied_cell(occupied: np.ndarray, radius_cells: float) -> None:
    apart = cdist(np.argwhere(np.ones_like(occupied)), np.argwhere(occupied)).min(axis=1, initial=np.inf)
    assert (inflate(occupied, radius_cells).ravel() == (apart <= radius_cells + 1e-9)).all()


@given(occupied_grids, st.integers(0, 12))
def test_square_agrees_with_scipy(occupied: np.ndarray, radius_cells: int) -> None:
    expected = ndimage.binary_dilation(occupied, np.ones((2 * radius_cells + 1,) * 2))
    assert (inflate_square(occupied, radius_cells) == expected).all()


def test_a_radius_in_metres_reaches_the_cells_it_names() -> None:
    occupied = np.zeros((9, 9), dtype=np.bool_)
    occupied[4, 4] = True
    grown = inflate(occupied, 0.3 / 0.1)  # a little less than 3
    assert grown[4].tolist() == grown[:, 4].tolist() == [False, True, True, True, True, True, True, True, False]


@pytest.mark.parametrize("radius", [-1.0, float("nan")])
def test_negative_radius_is_refused(radius: float) -> None:
    with pytest.raises(ValueError, match="inflation radius"):
        inflate(np.zeros((3, 3), dtype=np.bool_), radius)
