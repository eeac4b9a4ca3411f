"""Shared oracles: the cost of the best path by scipy's Dijkstra, and the rule of a legal path."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

STEPS = [(1, 0, 10), (0, 1, 10), (-1, 0, 10), (0, -1, 10), (1, 1, 14), (-1, 1, 14), (-1, -1, 14), (1, -1, 14)]


def _allowed(blocked: np.ndarray, col: int, row: int, dcol: int, drow: int, corner_cutting: bool) -> bool:
    rows, cols = blocked.shape
    if not (0 <= row + drow < rows and 0 <= col + dcol < cols) or blocked[row + drow, col + dcol]:
        return False
    return corner_cutting or dcol == 0 or drow == 0 or not (blocked[row, col + dcol] or blocked[row + drow, col])


@pytest.fixture(scope="session")
def costs_from() -> Callable:
    def costs(blocked: np.ndarray, start: tuple[int, int], corner_cutting: bool) -> np.ndarray:
        """Cost of the best path from start to every cell (rows, cols), inf where there is none."""
        rows, cols = blocked.shape
        padded = np.pad(blocked, 1, constant_values=True)
        index = np.arange(rows * cols).reshape(rows, cols)
        edges: list[list[np.ndarray]] = [[], [], []]
        for dcol, drow, cost in STEPS:
            to = padded[1 + drow : 1 + drow + rows, 1 + dcol : 1 + dcol + cols]
            legal = ~blocked & ~to
            if dcol and drow and not corner_cutting:
                legal &= ~padded[1 : 1 + rows, 1 + dcol : 1 + dcol + cols]
                legal &= ~padded[1 + drow : 1 + drow + rows, 1 : 1 + cols]
            leaving = index[legal]
            edges[0].append(leaving)
            edges[1].append(leaving + drow * cols + dcol)
            edges[2].append(np.full(len(leaving), cost))
        tail, head, weight = (np.concatenate(each) for each in edges)
        graph = coo_matrix((weight, (tail, head)), shape=(rows * cols, rows * cols)).tocsr()
        return dijkstra(graph, indices=start[1] * cols + start[0]).reshape(rows, cols)

    return costs


@pytest.fixture(scope="session")
def assert_legal() -> Callable:
    def check(plan, blocked: np.ndarray, start: tuple[int, int], goal: tuple[int, int], corner_cutting: bool) -> None:
        """A found plan starts and ends where asked, steps only where the rule allows, and adds up to its cost."""
        cells = plan.cells
        assert cells.dtype == np.int32
        assert tuple(cells[0]) == start
        assert tuple(cells[-1]) == goal
        assert not blocked[cells[:, 1], cells[:, 0]].any()
        cost = 0
        for (col, row), (next_col, next_row) in zip(cells[:-1].tolist(), cells[1:].tolist(), strict=True):
            dcol, drow = next_col - col, next_row - row
            assert max(abs(dcol), abs(drow)) == 1
            assert _allowed(blocked, col, row, dcol, drow, corner_cutting)
            cost += 14 if dcol and drow else 10
        assert plan.cost == cost

    return check
