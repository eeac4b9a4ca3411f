from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.planning.planners.ea_star import danger_levels
from quadlog.planning.rules import COSTS, HEURISTICS, TIES, Rules
from quadlog.planning.search.heap_search import Danger, HeapSearch

STEPS = [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)]
RULES = [
    Rules(costs, heuristic, ties, cutting)
    for costs, heuristic, ties, cutting in product(COSTS, HEURISTICS, TIES, (False, True))
]
# As printed for EA*, as it adds up, and neither.
CHARGES = [(1401, 1401, 2), (1401, 0, 0), (700, 350, 10)]


class TextbookHeap:
    """A list that is a binary heap of [key, cell]. Equal keys stay where they are."""

    def __init__(self):
        self.items = []

    def _rise(self, at):
        while at > 0 and self.items[at][0] < self.items[(at - 1) // 2][0]:
            self.items[at], self.items[(at - 1) // 2] = self.items[(at - 1) // 2], self.items[at]
            at = (at - 1) // 2

    def put(self, key, cell):
        at = next((i for i, (_, other) in enumerate(self.items) if other == cell), len(self.items))
        self.items[at : at + 1] = [(key, cell)]
        self._rise(at)

    def take(self):
        first, last = self.items[0], self.items.pop()
        if self.items:
            self.items[0] = last
            at = 0
            while 2 * at + 1 < len(self.items):
                children = range(2 * at + 1, min(2 * at + 3, len(self.items)))
                child = min(children, key=lambda i: (self.items[i][0], i))
                if not self.items[child][0] < last[0]:
                    break
                self.items[at], self.items[child] = self.items[child], self.items[at]
                at = child
        return first[1]


def reference(blocked, start, goal, rules, danger=None):
    """The same search in plain Python on a textbook's heap: (cells, expanded, generated, touched)."""
    straight, diagonal = (1000 * each for each in rules.step_units)
    levels = danger.levels if danger else np.zeros(blocked.shape, dtype=int)
    entering, leaving, same = (danger.entering, danger.leaving, danger.same_level) if danger else (0, 0, 0)
    one = straight // 1000

    def h(col, row):
        across, along = abs(goal[0] - col), abs(goal[1] - row)
        if rules.heuristic == "zero":
            return 0
        if rules.heuristic == "manhattan":
            return straight * (across + along)
        return straight * abs(across - along) + diagonal * min(across, along)

    def is_open(col, row):
        return 0 <= row < blocked.shape[0] and 0 <= col < blocked.shape[1] and not blocked[row, col]

    g, came_from, closed, opened, touched = {start: 0}, {}, set(), TextbookHeap(), 0
    opened.put((0, 0), start)
    while opened.items:
        at = opened.take()
        closed.add(at)
        if at == goal:
            cells = [goal]
            while cells[-1] != start:
                cells.append(came_from[cells[-1]])
            return cells[::-1], len(closed), len(g), touched
        for dcol, drow in STEPS:
            col, row = at[0] + dcol, at[1] + drow
            if not is_open(col, row):
                continue
            if dcol and drow and not rules.corner_cutting and not (is_open(col, at[1]) and is_open(at[0], row)):
                continue
            touched += 1
            level, before = int(levels[row, col]), int(levels[at[1], at[0]])
            new = g[at] + (diagonal if dcol and drow else straight) + one * (entering * level - leaving * before)
            new -= one * same if level == before else 0
            if (col, row) not in closed and ((col, row) not in g or new < g[col, row]):
                g[col, row], came_from[col, row] = new, at
                opened.put((new + h(col, row), -new if rules.ties == "larger_g" else new), (col, row))
    return [], len(closed), len(g), touched


def assert_same(plan, wanted):
    cells, *counts = wanted
    assert [plan.expanded, plan.generated, plan.touched] == counts
    assert plan.found == bool(cells)
    assert [tuple(cell) for cell in plan.cells.tolist()] == cells


def any_map(seed, density):
    """(blocked, start, goal), both free."""
    rng = np.random.default_rng(seed)
    blocked = rng.random(tuple(rng.integers(1, 22, 2))) < density
    start, goal = (tuple(rng.integers(0, blocked.shape[::-1]).tolist()) for _ in range(2))
    for col, row in (start, goal):
        blocked[row, col] = False
    return blocked, start, goal


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.15, 0.3, 0.45]), st.sampled_from(RULES))
def test_step_by_step_against_plain_python(seed, density, rules):
    """The overrating heuristic as well: what is closed stays closed in both."""
    blocked, start, goal = any_map(seed, density)
    assert_same(HeapSearch(rules).search(blocked, start, goal), reference(blocked, start, goal, rules))


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.02, 0.1, 0.3]),
    st.sampled_from([rules for rules in RULES if rules.costs == "integer"]),
    st.integers(0, 3),
    st.sampled_from(CHARGES),
)
def test_danger_step_by_step_against_plain_python(seed, density, rules, rings, charges):
    blocked, start, goal = any_map(seed, density)
    danger = Danger(danger_levels(blocked, rings), *charges)
    assert_same(HeapSearch(rules).search(blocked, start, goal, danger), reference(blocked, start, goal, rules, danger))


@pytest.mark.parametrize("costs", COSTS)
def test_exact_and_integer_charges_weigh_the_same(costs):
    """Along a wall of level 1 and a detour of k diagonal steps: which is cheaper turns at the same length."""
    levels = np.zeros((3, 40), dtype=np.int8)
    levels[1, 10:30] = 1
    blocked = np.zeros((3, 40), dtype=bool)
    for charge, through in ((20, True), (60, False)):
        # Twenty cells of the charge against two diagonal steps, .8 to .83 of a straight one dearer.
        plan = HeapSearch(Rules(costs)).search(blocked, (5, 1), (35, 1), Danger(levels, charge, 0, 0))
        assert (plan.cells[:, 1] == 1).all() == through


@pytest.mark.parametrize("costs", COSTS)
def test_no_sum_overflows_on_the_largest_map(costs):
    """A hall that winds through half of 8192 x 8192 cells, every one of them of level 3."""
    search = HeapSearch(Rules(costs))
    straight, diagonal, _, _, entering, *_ = search._parameters(Danger(np.zeros((1, 1), dtype=np.int8), 1401, 0, 0))
    assert (int(diagonal) + 3 * int(entering)) * 8192**2 // 2 < 2**63
    assert entering / straight == pytest.approx(1.401, rel=1e-9)
