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


class SlidingWorld:
    """A window on a world whose obstacles come and go, with a robot and a goal, all drawn from one seed."""

    def __init__(self, seed: int, density: float) -> None:
        self.rng = np.random.default_rng(seed)
        self.world = self.rng.random((80, 80)) < density
        self.origin = np.array([30, 30])
        self.shape = (int(self.rng.integers(1, 25)), int(self.rng.integers(2, 25)))
        self.start, self.goal = self._any_cell(), self._any_cell()

    def step(self, moves: set[str]) -> tuple[np.ndarray, tuple[int, int], tuple[int, int], tuple[int, int]]:
        """What Planner.plan takes after some of "map", "window", "shape", "start", "goal" changed."""
        rng, before = self.rng, self.origin
        if "map" in moves:
            self.world = self.world ^ (rng.random(self.world.shape) < rng.choice([0.003, 0.03, 0.2], p=[0.6, 0.3, 0.1]))
        if "window" in moves:
            farthest = 40 if rng.random() < 0.05 else 3
            self.origin = np.clip(before + rng.integers(-farthest, farthest + 1, 2), 0, 54)
        if "shape" in moves:
            self.shape = (int(rng.integers(1, 25)), int(rng.integers(2, 25)))
        if "start" in moves:
            self.start = self._any_cell() if rng.random() < 0.2 else self.start + rng.integers(-2, 3, 2)
        if "goal" in moves:
            self.goal = self._any_cell() if rng.random() < 0.2 else self.goal + rng.integers(-2, 3, 2)
        if rng.random() < 0.9:
            # Mostly a query that has an answer: both in the window, and free.
            low, high = self.origin, self.origin + self.shape[::-1] - 1
            self.start, self.goal = np.clip(self.start, low, high), np.clip(self.goal, low, high)
            for col, row in (self.start, self.goal):
                self.world[row, col] = False
        (col, row), (rows, cols) = self.origin, self.shape
        start, goal, shift = (tuple(int(v) for v in xy) for xy in self._seen(before))
        return self.world[row : row + rows, col : col + cols].copy(), start, goal, shift

    def _seen(self, before: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.start - self.origin, self.goal - self.origin, self.origin - before

    def _any_cell(self) -> np.ndarray:
        return self.origin + self.rng.integers(0, self.shape[::-1])


@pytest.fixture(scope="session")
def assert_optimal_throughout(costs_from: Callable, assert_legal: Callable) -> Callable:
    def check(planner, seed: int, density: float, moves: list[set[str]], corner_cutting: bool) -> list:
        """Plans after each of the moves, every one as good as Dijkstra's; returns them."""
        world, plans = SlidingWorld(seed, density), []
        for each in moves:
            blocked, start, goal, shift = world.step(each)
            plan = planner.plan(blocked, start, goal, shift)
            plans.append(plan)
            inside = all(0 <= c < blocked.shape[1] and 0 <= r < blocked.shape[0] for c, r in (start, goal))
            if not inside or blocked[start[1], start[0]] or blocked[goal[1], goal[0]]:
                assert not plan.found
                continue
            best = costs_from(blocked, start, corner_cutting)[goal[1], goal[0]]
            assert plan.found == np.isfinite(best)
            if plan.found:
                assert plan.cost == best
                assert_legal(plan, blocked, start, goal, corner_cutting)
            else:
                assert plan.cost == -1
                assert plan.cells.shape == (0, 2)
            assert plan.expanded <= 2 * plan.generated
            assert plan.generated <= blocked.size
        return plans

    return check


@pytest.fixture(scope="session")
def forest() -> Callable:
    """A function that makes a map (40, 40) of scattered obstacles, in which start (2, 2) and goal (30, 35) are free."""

    def make(seed: int = 5, density: float = 0.15) -> np.ndarray:
        blocked = np.random.default_rng(seed).random((40, 40)) < density
        blocked[2, 2] = blocked[35, 30] = blocked[34, 30] = blocked[3, 2] = False
        return blocked

    return make
