from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest
from scipy.ndimage import distance_transform_cdt
from scipy.sparse.csgraph import bellman_ford

from quadlog.planning.planners.astar import AStar
from quadlog.planning.planners.ea_star import EAStar, danger_levels
from quadlog.planning.rules import TIES, Rules

RULES = [Rules(ties=ties, corner_cutting=cutting) for ties, cutting in product(TIES, (False, True))]


def charged_steps(steps_between, blocked, rules, rings):
    """(graph of steps with eq. 12's charges in hundredths, 14.01 for a level; levels (cells,)), without the 0.02."""
    levels = danger_levels(blocked, rings).reshape(-1).astype(int)
    graph = steps_between(blocked, rules) * 100
    leaving = np.repeat(np.arange(blocked.size), np.diff(graph.indptr))
    graph.data += 1401 * levels[graph.indices] - 1401 * levels[leaving]
    return graph, levels


@pytest.mark.parametrize("rings", [1, 2, 3])
@pytest.mark.parametrize("rules", RULES, ids=str)
def test_charges_telescope(steps_between, rules, rings):
    """The erratum: along any path they add up to the last level less the first, whatever the way."""
    rng = np.random.default_rng(rings)
    blocked = rng.random((20, 25)) < 0.06
    free = np.argwhere(~blocked)
    graph, levels = charged_steps(steps_between, blocked, rules, rings)
    for _ in range(20):
        (row, col), (to_row, to_col) = free[rng.integers(0, len(free), 2)].tolist()
        plan = EAStar(rules, rings).plan(blocked, (col, row), (to_col, to_row))
        if plan.found:
            at = plan.cells[:, 1] * 25 + plan.cells[:, 0]
            charged = sum(graph[a, b] for a, b in pairwise(at))
            assert charged == 100 * plan.cost + 1401 * (levels[at[-1]] - levels[at[0]])


@pytest.mark.parametrize("rings", [1, 2, 3])
@pytest.mark.parametrize("rules", RULES, ids=str)
def test_a_search_that_never_ends_early_returns_the_length_of_astar(steps_between, rules, rings):
    """The erratum: by the same costs Bellman and Ford's search, which reconsiders, makes no detour."""
    blocked = np.zeros((16, 18), dtype=bool)
    blocked[6:10, 7:12] = True
    graph, levels = charged_steps(steps_between, blocked, rules, rings)
    assert (graph.data < 0).any()
    start, goal = (1, 8), (16, 7)
    best = bellman_ford(graph, indices=start[1] * 18 + start[0])[goal[1] * 18 + goal[0]]
    assert levels[start[1] * 18 + start[0]] == levels[goal[1] * 18 + goal[0]] == 0
    assert best == 100 * AStar(rules).plan(blocked, start, goal).cost


@pytest.mark.parametrize("rules", RULES, ids=str)
@pytest.mark.parametrize(("rings", "clearance"), [(0, 1), (1, 2), (2, 3), (3, 4)])
@pytest.mark.parametrize("beside_the_middle", [0, 4, 7])
def test_keeps_clear_of_an_obstacle(rings, clearance, beside_the_middle, rules):
    """A square of 1.6 m in cells of 0.1 m, 2.2 m away: the nearest cell of the path is the first beyond the rings."""
    blocked = np.zeros((60, 80), dtype=bool)
    blocked[22:38, 32:48] = True
    row = 29 - beside_the_middle
    cells = EAStar(rules, rings).plan(blocked, (10, row), (70, row)).cells
    away = distance_transform_cdt(~blocked, "chessboard")
    assert away[cells[:, 1], cells[:, 0]].min() == clearance


def test_a_near_start_makes_no_detour():
    """The charge for a ring is worth a few cells of searching: from six cells away all of them are soon closed."""
    blocked = np.zeros((60, 80), dtype=bool)
    blocked[22:38, 32:48] = True
    away = distance_transform_cdt(~blocked, "chessboard")
    for rings in (1, 2, 3):
        cells = EAStar(rings=rings).plan(blocked, (26, 29), (53, 29)).cells
        assert away[cells[:, 1], cells[:, 0]].min() == 1


@pytest.mark.parametrize("width", [9, 5, 3])
@pytest.mark.parametrize("rings", [1, 2, 3])
def test_a_passage_stays_open(width, rings):
    """A wall 1 m deep. Growing it by three cells would close the two narrower ones."""
    blocked = np.zeros((60, 50), dtype=bool)
    blocked[:, 20:30] = True
    blocked[30 : 30 + width, 20:30] = False
    plan = EAStar(rings=rings).plan(blocked, (5, 10), (45, 10))
    assert plan.found
