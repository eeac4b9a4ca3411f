"""Shared oracles: the cost of the best path by scipy's Dijkstra, and the rule of a legal path."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from quadlog.planning.rules import USUAL, Rules

STEPS = [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)]
STEP_COSTS = {"integer": (10, 14), "exact": (1, math.sqrt(2))}


def assert_same_cost(cost: float, expected: float, rules: Rules) -> None:
    """To the last digit where costs are whole; else up to the rounding of sums in another order."""
    assert cost == (expected if rules.costs == "integer" else pytest.approx(expected, rel=1e-12))


def _allowed(blocked: np.ndarray, col: int, row: int, dcol: int, drow: int, corner_cutting: bool) -> bool:
    rows, cols = blocked.shape
    if not (0 <= row + drow < rows and 0 <= col + dcol < cols) or blocked[row + drow, col + dcol]:
        return False
    return corner_cutting or dcol == 0 or drow == 0 or not (blocked[row, col + dcol] or blocked[row + drow, col])


@pytest.fixture(scope="session")
def steps_between() -> Callable:
    def steps(blocked: np.ndarray, rules: Rules = USUAL) -> csr_array:
        """The graph of all legal steps with what they cost: (cells, cells), a cell's index being row * cols + col."""
        rows, cols = blocked.shape
        padded = np.pad(blocked, 1, constant_values=True)
        index = np.arange(rows * cols).reshape(rows, cols)
        edges: list[list[np.ndarray]] = [[], [], []]
        for dcol, drow in STEPS:
            to = padded[1 + drow : 1 + drow + rows, 1 + dcol : 1 + dcol + cols]
            legal = ~blocked & ~to
            if dcol and drow and not rules.corner_cutting:
                legal &= ~padded[1 : 1 + rows, 1 + dcol : 1 + dcol + cols]
                legal &= ~padded[1 + drow : 1 + drow + rows, 1 : 1 + cols]
            leaving = index[legal]
            edges[0].append(leaving)
            edges[1].append(leaving + drow * cols + dcol)
            edges[2].append(np.full(len(leaving), STEP_COSTS[rules.costs][bool(dcol and drow)]))
        tail, head, weight = (np.concatenate(each) for each in edges)
        return csr_array((weight, (tail, head)), shape=(rows * cols, rows * cols))

    return steps


@pytest.fixture(scope="session")
def costs_from(steps_between: Callable) -> Callable:
    def costs(blocked: np.ndarray, start: tuple[int, int], rules: Rules = USUAL) -> np.ndarray:
        """Cost of the best path from start to every cell (rows, cols), inf where there is none."""
        from_start = dijkstra(steps_between(blocked, rules), indices=start[1] * blocked.shape[1] + start[0])
        return from_start.reshape(blocked.shape)

    return costs


@pytest.fixture(scope="session")
def assert_legal() -> Callable:
    def check(plan, blocked: np.ndarray, start: tuple[int, int], goal: tuple[int, int], rules: Rules = USUAL) -> None:
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
            assert _allowed(blocked, col, row, dcol, drow, rules.corner_cutting)
            cost += STEP_COSTS[rules.costs][bool(dcol and drow)]
        assert_same_cost(plan.cost, cost, rules)

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
def assert_plan(assert_legal: Callable) -> Callable:
    def check(plan, blocked, start, goal, rules: Rules, best: float, excess: float = 1.0) -> None:
        """best: what the cheapest path costs, inf where there is none; the plan costs at most `excess` times that."""
        cells = (start, goal)
        inside = all(0 <= c < blocked.shape[1] and 0 <= r < blocked.shape[0] for c, r in cells)
        can = inside and not any(blocked[row, col] for col, row in cells)
        assert plan.found == (can and np.isfinite(best))
        assert plan.reused_cells == 0 or not plan.from_scratch
        if not plan.found:
            assert (plan.cost, plan.cells.shape, plan.reused_cells) == (-1, (0, 2), 0)
            assert can or plan.expanded == 0
            return
        assert_legal(plan, blocked, start, goal, rules)
        if excess == 1:
            assert_same_cost(plan.cost, best, rules)
            assert plan.generated <= blocked.size
        else:
            assert best * (1 - 1e-12) <= plan.cost
            assert plan.cost == 0 if best == 0 else plan.cost <= excess * best * (1 + 1e-12)

    return check


@pytest.fixture(scope="session")
def assert_throughout(costs_from: Callable, assert_plan: Callable) -> Callable:
    def check(planner, seed: int, density: float, moves: list[set[str]], excess: float = 1.0) -> list:
        """Plans after each of the moves, see assert_plan; returns them."""
        world, plans, rules = SlidingWorld(seed, density), [], planner.rules
        for each in moves:
            blocked, start, goal, shift = world.step(each)
            plans.append(planner.plan(blocked, start, goal, shift))
            best = np.inf
            if all(0 <= c < blocked.shape[1] and 0 <= r < blocked.shape[0] for c, r in (start, goal)):
                best = costs_from(blocked, start, rules)[goal[1], goal[0]]
            assert_plan(plans[-1], blocked, start, goal, rules, best, excess)
        return plans

    return check


def _maze(rng: np.random.Generator, rows: int, cols: int) -> np.ndarray:
    """Halls one cell wide, by a walk that goes on from wherever it can; exactly one way between any two cells."""
    blocked = np.ones((2 * rows + 1, 2 * cols + 1), dtype=bool)
    stack, blocked[1, 1] = [(1, 1)], False
    while stack:
        col, row = stack[-1]
        ahead = [
            (dcol, drow) for dcol, drow in STEPS[:4] if 0 < col + 2 * dcol < 2 * cols and 0 < row + 2 * drow < 2 * rows
        ]
        ahead = [step for step in ahead if blocked[row + 2 * step[1], col + 2 * step[0]]]
        if not ahead:
            stack.pop()
            continue
        dcol, drow = ahead[rng.integers(len(ahead))]
        blocked[row + drow, col + dcol] = blocked[row + 2 * drow, col + 2 * dcol] = False
        stack.append((col + 2 * dcol, row + 2 * drow))
    return blocked


@pytest.fixture(scope="session")
def grids() -> dict[str, np.ndarray]:
    """Maps of every kind by name."""
    rng = np.random.default_rng(3)
    stripes = np.zeros((37, 33), dtype=bool)
    for i, row in enumerate(range(4, 37, 6)):
        stripes[row] = True
        stripes[row, 1 if i % 2 else -2] = False
    rooms = np.zeros((41, 51), dtype=bool)
    rooms[::10], rooms[:, ::10] = True, True
    rooms[5::10, ::10], rooms[::10, 5::10] = False, False
    corners = np.indices((12, 12)).sum(axis=0) % 2 == 1
    corners[:, 6] = False
    row_of_cells = np.zeros((1, 60), dtype=bool)
    broken_column = np.zeros((60, 1), dtype=bool)
    broken_column[40] = True
    return {
        "stripes": stripes,
        "rooms": rooms,
        "maze": _maze(rng, 12, 15),
        "maze with doors": _maze(rng, 15, 12) & (rng.random((31, 25)) > 0.1),
        "corners": corners,
        "open": np.zeros((35, 20), dtype=bool),
        "no free cell": np.ones((7, 9), dtype=bool),
        "one free cell": np.zeros((1, 1), dtype=bool),
        "one row": row_of_cells,
        "one column": broken_column,
        "two rows": rng.random((2, 50)) < 0.2,
        **{f"random {density}": rng.random((40, 36)) < density for density in (0.05, 0.15, 0.25, 0.35, 0.45)},
    }


@pytest.fixture(scope="session")
def cells_of() -> Callable:
    def cells(blocked: np.ndarray, count: int, seed: int) -> list[tuple[int, int]]:
        """So many cells (col, row) drawn from one seed: the first free if there is one, the others 19 times in 20."""
        rng = np.random.default_rng(seed)
        rows, cols = np.nonzero(~blocked if not blocked.all() else blocked)
        drawn = [(int(cols[i]), int(rows[i])) for i in rng.integers(0, len(rows), count)]
        anywhere = rng.integers(0, blocked.shape[::-1], (count, 2)).tolist()
        for i in range(1, count):
            if rng.random() < 0.05:
                drawn[i] = (anywhere[i][0], anywhere[i][1])
        return drawn

    return cells


@pytest.fixture(scope="session")
def forest() -> Callable:
    """A function that makes a map (40, 40) of scattered obstacles, in which start (2, 2) and goal (30, 35) are free."""

    def make(seed: int = 5, density: float = 0.15) -> np.ndarray:
        blocked = np.random.default_rng(seed).random((40, 40)) < density
        blocked[2, 2] = blocked[35, 30] = blocked[34, 30] = blocked[3, 2] = False
        return blocked

    return make
