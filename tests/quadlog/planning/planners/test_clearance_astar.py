from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_cdt
from scipy.sparse.csgraph import dijkstra

from quadlog.planning.planners.astar import AStar
from quadlog.planning.planners.ea_star import ClearanceAStar, danger_levels
from quadlog.planning.rules import COSTS, TIES, Rules

RULES = [
    Rules(costs=costs, ties=ties, corner_cutting=cutting)
    for costs, ties, cutting in product(COSTS, TIES, (False, True))
]


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.02, 0.1, 0.3]), st.integers(0, 4), st.sampled_from(RULES))
def test_steps_and_charges_equal_dijkstras(steps_between, seed, density, rings, rules):
    """On the directed graph in which a step costs its length, and 14.01 for each level of the cell it enters."""
    rng = np.random.default_rng(seed)
    blocked = rng.random(tuple(rng.integers(2, 20, 2))) < density
    (start, goal), cols = rng.integers(0, blocked.shape[::-1], (2, 2)).tolist(), blocked.shape[1]
    blocked[start[1], start[0]] = blocked[goal[1], goal[0]] = False
    levels = danger_levels(blocked, rings).reshape(-1).astype(int)
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


def test_without_rings_it_is_astar(forest):
    for seed in range(5):
        blocked = forest(seed, 0.25)
        ours, best = (each.plan(blocked, (2, 2), (30, 35)) for each in (ClearanceAStar(rings=0), AStar()))
        assert ours.cost == best.cost


@pytest.mark.parametrize("rules", RULES, ids=str)
@pytest.mark.parametrize(("rings", "clearance"), [(1, 2), (2, 3), (3, 4)])
@pytest.mark.parametrize("beside_the_middle", [0, 4, 7])
def test_keeps_clear_of_an_obstacle(rings, clearance, beside_the_middle, rules):
    """A square of 1.6 m in cells of 0.1 m: the nearest cell of the path is the first beyond the rings."""
    blocked = np.zeros((60, 80), dtype=bool)
    blocked[22:38, 32:48] = True
    row = 29 - beside_the_middle
    cells = ClearanceAStar(rules, rings).plan(blocked, (10, row), (70, row)).cells
    away = distance_transform_cdt(~blocked, "chessboard")
    assert away[cells[:, 1], cells[:, 0]].min() == clearance


@pytest.mark.parametrize(("width", "clearance"), [(9, 4), (5, 3), (3, 2)])
def test_a_passage_stays_open_and_is_walked_in_its_middle(width, clearance):
    """A wall 1 m deep, of which three rings on either side leave three cells, or none: there is no other way."""
    blocked = np.zeros((60, 50), dtype=bool)
    blocked[:, 20:30] = True
    blocked[30 : 30 + width, 20:30] = False
    cells = ClearanceAStar().plan(blocked, (5, 10), (45, 10)).cells
    inside = cells[(cells[:, 0] >= 20) & (cells[:, 0] < 30)]
    away = distance_transform_cdt(~blocked, "chessboard")
    assert away[inside[:, 1], inside[:, 0]].min() == clearance
