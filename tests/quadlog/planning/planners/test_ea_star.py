from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import distance_transform_cdt
from scipy.sparse.csgraph import bellman_ford, dijkstra

from quadlog.planning.planners.astar import AStar
from quadlog.planning.planners.ea_star import ClearanceAStar, EAStar, danger_levels
from quadlog.planning.rules import COSTS, TIES, Rules

RULES = [
    Rules(costs=costs, ties=ties, corner_cutting=cutting)
    for costs, ties, cutting in product(COSTS, TIES, (False, True))
]
INTEGER_RULES = [rules for rules in RULES if rules.costs == "integer"]
both = pytest.mark.parametrize("make", [EAStar, ClearanceAStar])


@given(
    arrays(bool, st.tuples(st.integers(1, 15), st.integers(1, 15)), elements=st.sampled_from([False] * 9 + [True])),
    st.integers(0, 5),
)
def test_one_less_for_each_ring_away(blocked, rings):
    """Against scipy's chessboard distance."""
    away = distance_transform_cdt(np.pad(~blocked, 1, constant_values=True), "chessboard")[1:-1, 1:-1]
    wanted = np.maximum(rings + 1 - away, 0) if blocked.any() else np.zeros(blocked.shape)
    levels = danger_levels(blocked, rings)
    assert levels.dtype == np.int8
    np.testing.assert_array_equal(levels[~blocked], wanted[~blocked])
    assert not levels[blocked].any()


def charged_steps(steps_between, blocked, rules, rings):
    """(graph of steps with eq. 12's charges in hundredths, 14.01 for a level; levels (cells,)), without the 0.02."""
    levels = danger_levels(blocked, rings).reshape(-1).astype(int)
    graph = steps_between(blocked, rules) * 100
    leaving = np.repeat(np.arange(blocked.size), np.diff(graph.indptr))
    graph.data += 1401 * levels[graph.indices] - 1401 * levels[leaving]
    return graph, levels


@pytest.mark.parametrize("rings", [1, 2, 3])
@pytest.mark.parametrize("rules", INTEGER_RULES, ids=str)
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
@pytest.mark.parametrize("rules", INTEGER_RULES, ids=str)
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
