from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_cdt
from scipy.sparse.csgraph import bellman_ford, dijkstra

from quadlog.planning.planners.astar import AStar
from quadlog.planning.planners.ea_star import ClearanceAStar, EAStar
from quadlog.planning.rules import COSTS, TIES, Rules

RULES = [
    Rules(costs=costs, ties=ties, corner_cutting=cutting)
    for costs, ties, cutting in product(COSTS, TIES, (False, True))
]
INTEGER_RULES = [rules for rules in RULES if rules.costs == "integer"]
both = pytest.mark.parametrize("make", [EAStar, ClearanceAStar])


def levels_of(blocked, rings):
    """(cells,) by scipy's chessboard distance: one less for each ring away from an obstacle."""
    away = distance_transform_cdt(np.pad(~blocked, 1, constant_values=True), "chessboard")[1:-1, 1:-1]
    near = np.maximum(rings + 1 - away, 0) if blocked.any() else np.zeros(blocked.shape, int)
    return np.where(blocked, 0, near).reshape(-1)


def test_a_search_that_never_ends_early_returns_the_length_of_astar(steps_between):
    """The erratum: by eq. 12's costs Bellman and Ford's search, which reconsiders, makes no detour, as EA* does."""
    blocked, start, goal = np.zeros((16, 18), dtype=bool), (1, 8), (16, 7)
    blocked[6:10, 7:12] = True
    graph, levels = steps_between(blocked) * 100, levels_of(blocked, 3)
    graph.data += 1401 * (levels[graph.indices] - levels[np.repeat(np.arange(blocked.size), np.diff(graph.indptr))])
    best = bellman_ford(graph, indices=start[1] * 18 + start[0])[goal[1] * 18 + goal[0]]
    assert best == 100 * AStar().plan(blocked, start, goal).cost < 100 * EAStar().plan(blocked, start, goal).cost


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.02, 0.1, 0.3]), st.integers(0, 4), st.sampled_from(RULES))
def test_steps_and_charges_equal_dijkstras(steps_between, seed, density, rings, rules):
    """On the directed graph in which a step costs its length, and 14.01 for each level of the cell it enters."""
    rng = np.random.default_rng(seed)
    blocked = rng.random(tuple(rng.integers(2, 20, 2))) < density
    (start, goal), cols = rng.integers(0, blocked.shape[::-1], (2, 2)).tolist(), blocked.shape[1]
    blocked[start[1], start[0]] = blocked[goal[1], goal[0]] = False
    levels = levels_of(blocked, rings)
    # In hundredths of 10/14 costs, whole numbers; or in cells.
    unit, level = (100, 1401) if rules.costs == "integer" else (1, 1.401)
    graph = steps_between(blocked, rules) * unit
    graph.data += level * levels[graph.indices]
    best = dijkstra(graph, indices=start[1] * cols + start[0])[goal[1] * cols + goal[0]]
    plan = ClearanceAStar(rules, rings).plan(blocked, tuple(start), tuple(goal))
    assert plan.found == np.isfinite(best)
    if plan.found:
        ours = plan.cost * unit + level * levels[plan.cells[1:, 1] * cols + plan.cells[1:, 0]].sum()
        assert ours == (best if rules.costs == "integer" else pytest.approx(best, rel=1e-9))


@both
@pytest.mark.parametrize("rules", INTEGER_RULES, ids=str)
@pytest.mark.parametrize(("rings", "clearance"), [(0, 1), (1, 2), (2, 3), (3, 4)])
@pytest.mark.parametrize("beside_the_middle", [0, 4, 7])
def test_keeps_clear_of_an_obstacle(make, rings, clearance, beside_the_middle, rules):
    """A square of 1.6 m in cells of 0.1 m, 2.2 m away: the nearest cell of the path is the first beyond the rings."""
    blocked = np.zeros((60, 80), dtype=bool)
    blocked[22:38, 32:48] = True
    row = 29 - beside_the_middle
    cells = make(rules, rings).plan(blocked, (10, row), (70, row)).cells
    away = distance_transform_cdt(~blocked, "chessboard")
    assert away[cells[:, 1], cells[:, 0]].min() == clearance


@both
@pytest.mark.parametrize(("width", "clearance"), [(9, 4), (5, 3), (3, 2)])
def test_a_passage_stays_open(make, width, clearance):
    """A wall 1 m deep, of which growth by three cells would leave three cells, or none: there is no other way."""
    blocked = np.zeros((60, 50), dtype=bool)
    blocked[:, 20:30] = True
    blocked[30 : 30 + width, 20:30] = False
    plan = make().plan(blocked, (5, 10), (45, 10))
    assert plan.found
    inside = plan.cells[(plan.cells[:, 0] >= 20) & (plan.cells[:, 0] < 30)]
    away = distance_transform_cdt(~blocked, "chessboard")
    # In its middle, where charges are not given back.
    assert make is EAStar or away[inside[:, 1], inside[:, 0]].min() == clearance
