from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from quadlog.mapping.goal_projection import DETOUR, escape_start
from quadlog.mapping.inflation import inflate


def costs_by_scipy(occupied: np.ndarray, start: tuple[int, int]) -> np.ndarray:
    rows, cols = occupied.shape
    steps = []
    for row in range(rows):
        for col in range(cols):
            for dr, dc in ((a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b):
                r, c = row + dr, col + dc
                if not (0 <= r < rows and 0 <= c < cols) or occupied[r, c]:
                    continue
                if dr and dc and (occupied[row, c] or occupied[r, col]):
                    continue
                steps.append((row * cols + col, r * cols + c, 14 if dr and dc else 10))
    steps = np.array(steps, dtype=np.int64).reshape(-1, 3)
    graph = coo_matrix((steps[:, 2], (steps[:, 0], steps[:, 1])), shape=(rows * cols, rows * cols))
    return dijkstra(graph.tocsr(), indices=start[1] * cols + start[0]).reshape(rows, cols)


@settings(deadline=None)
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
    walked = sum(14 if both else 10 for both in (steps.sum(axis=1) == 2))
    assert walked == cost.min()


@settings(deadline=None)
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

    def walked(path) -> int:
        return sum(14 if step.all() else 10 for step in np.diff(path.astype(np.int64), axis=0) != 0)

    assert walked(escape.path) <= least + DETOUR
    assert walked(escape.path) + on[escape.cell[1], escape.cell[0]] <= least + on[nearest.cell[1], nearest.cell[0]]


def test_beside_a_wall_it_gets_out_ahead_and_not_behind() -> None:
    """In the growth of a wall's end the nearest free cell lies behind; one ahead costs a step more and saves two."""
    occupied = np.zeros((9, 15), dtype=np.bool_)
    occupied[0, :] = True
    blocked = inflate(occupied, 3)
    blocked[1:4, :6] = False
    assert escape_start(occupied, blocked, (6, 2)).cell == (5, 2)
    cell = escape_start(occupied, blocked, (6, 2), (14, 4)).cell
    assert cell[0] >= 6
    assert cell[1] == 4


def test_walled_in_or_outside_is_none() -> None:
    occupied = np.ones((5, 5), dtype=np.bool_)
    occupied[2, 2] = False
    assert escape_start(occupied, np.ones((5, 5), dtype=np.bool_), (2, 2)) is None
    assert escape_start(occupied, occupied, (5, 2)) is None
    assert escape_start(occupied, occupied, (-1, 2)) is None
