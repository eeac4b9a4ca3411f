from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.distance import cdist

from quadlog.mapping.goal_projection import DETOUR, INFLATIONS, escape_start, inflate, project_goal
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


@given(grids(), st.data())
def test_projection_is_reachable_and_the_nearest_such_cell(blocked: np.ndarray, data: st.DataObject) -> None:
    rows, cols = blocked.shape
    window = Window(data.draw(st.integers(-50, 50)), data.draw(st.integers(-50, 50)), 0.1, (rows, cols))
    start = (data.draw(st.integers(0, cols - 1)), data.draw(st.integers(0, rows - 1)))
    blocked[start[1], start[0]] = False
    goal_cell = np.array([data.draw(st.integers(-30, cols + 30)), data.draw(st.integers(-30, rows + 30))])

    col, row = project_goal(blocked, window, start, window.centre_of(goal_cell))

    reachable = np.isfinite(costs_by_scipy(blocked, start))
    assert reachable[row, col]
    if window.contains(goal_cell):
        away = ((np.argwhere(reachable)[:, ::-1] - goal_cell) ** 2).sum(axis=1)
        assert ((np.array([col, row]) - goal_cell) ** 2).sum() == away.min()
    else:
        edge = np.zeros_like(blocked)
        edge[[0, -1]] = edge[:, [0, -1]] = True
        assert edge[row, col] or not (edge & reachable).any()


@pytest.mark.parametrize(
    ("goal_cell", "wall", "expected"),
    [
        ((130, 20), (), (59, 20)),
        ((-70, 20), (), (0, 20)),
        ((30, 1020), (), (30, 39)),
        ((30, -500), (), (30, 0)),
        ((130, 118), (), (50, 39)),
        ((10**15, 20), (), (59, 20)),
        ((130, 20), range(15, 24), (59, 24)),  # the crossing is (59, 20): five cells up are blocked, six down
        ((130, 20), range(15, 26), (59, 26)),  # now six each way: counter-clockwise is up here
        ((130, 20), range(15, 40), (59, 14)),
    ],
)
def test_goal_beyond_the_window_is_where_the_line_leaves_it_or_along_the_margin(goal_cell, wall, expected) -> None:
    blocked = np.zeros((40, 60), dtype=np.bool_)
    blocked[list(wall), 59] = True
    assert project_goal(blocked, WINDOW, (30, 20), WINDOW.centre_of(np.array(goal_cell))) == expected


@given(st.integers(0, 2**32), st.integers(1, 15), st.integers(1, 15), st.floats(0, 0.2), st.floats(0, 6))
def test_the_way_out_leads_towards_the_goal_and_is_hardly_longer_than_the_shortest_by_scipys_dijkstra(
    seed: int, rows: int, cols: int, share: float, radius: float
) -> None:
    random = np.random.default_rng(seed)
    occupied = random.random((rows, cols)) < share
    blocked = inflate(occupied, radius)
    start, goal = (int(random.integers(cols)), int(random.integers(rows))), tuple(random.integers(-5, 20, 2).tolist())
    way = escape_start(occupied, blocked, start, goal)
    cost = np.where(blocked, np.inf, costs_by_scipy(occupied, start))
    assert (way is None) == np.isinf(cost).all()
    if way is None:
        return
    path = way.astype(np.int64)
    assert tuple(path[0]) == start
    assert not occupied[path[1:, 1], path[1:, 0]].any()
    assert (np.abs(np.diff(path, axis=0)).max(axis=1, initial=0) == (1 if len(path) > 1 else 0)).all()
    # All but the last cell lie in the growth: it leaves it once.
    assert (blocked[path[:, 1], path[:, 0]] == (np.arange(len(path)) < len(path) - 1)).all()
    away = np.abs(np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1) - goal)
    on = 10 * away.max(axis=-1) + 4 * away.min(axis=-1)
    walked = sum(14 if step.all() else 10 for step in np.diff(path, axis=0) != 0)
    assert walked <= cost.min() + DETOUR
    assert walked + on[tuple(path[-1])[::-1]] <= (cost + on)[cost == cost.min()].min()


@example(np.arange(81).reshape(9, 9) == 40, 0.3 / 0.1)  # in metres; a little less than 3
@given(
    arrays(np.bool_, st.tuples(st.integers(1, 30), st.integers(1, 30))),
    st.one_of(st.floats(0, 12), st.integers(0, 12).map(float)),
)
def test_growth_is_by_distance_and_in_squares_as_scipys(occupied: np.ndarray, radius_cells: float) -> None:
    apart = cdist(np.argwhere(np.ones_like(occupied)), np.argwhere(occupied)).min(axis=1, initial=np.inf)
    assert (inflate(occupied, radius_cells).ravel() == (apart <= radius_cells + 1e-9)).all()
    expected = ndimage.binary_dilation(occupied, np.ones((2 * int(radius_cells + 1e-9) + 1,) * 2))
    assert (INFLATIONS["square"](occupied, radius_cells) == expected).all()
