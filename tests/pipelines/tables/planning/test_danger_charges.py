from __future__ import annotations

from itertools import pairwise

import networkx as nx
import numpy as np
import pytest

from quadlog.pipelines.tables.planning.ea_star import GROWN, cheapest_path, narrowest
from quadlog.planning.planners.astar import AStar
from quadlog.planning.planners.ea_star import danger_levels


def printed_cost(levels, cells):
    """Eq. 13 along a path, cell by cell."""
    cost = 0.0
    for (col, row), (to_col, to_row) in pairwise(cells):
        before, after = int(levels[row, col]), int(levels[to_row, to_col])
        cost += 14 if to_col != col and to_row != row else 10
        cost += (after - before) * 14.01 - 0.02 * (after == before)
    return cost


@pytest.mark.parametrize("rings", [1, 3])
@pytest.mark.parametrize("seed", range(4))
def test_the_cheapest_way_by_the_printed_charges_is_networkxs_and_as_short_as_that_of_a_star(seed, rings):
    occupied = np.random.default_rng(seed).random((9, 11)) < 0.15
    start, goal = (0, 0), (10, 8)
    occupied[0, 0] = occupied[8, 10] = False
    plan = AStar().plan(occupied, start, goal)
    assert plan.found
    levels = danger_levels(occupied, rings)
    graph = nx.DiGraph()
    for row, col in np.argwhere(~occupied).tolist():
        for drow in (-1, 0, 1):
            for dcol in (-1, 0, 1):
                to_row, to_col = row + drow, col + dcol
                if (drow, dcol) == (0, 0) or not (0 <= to_row < 9 and 0 <= to_col < 11) or occupied[to_row, to_col]:
                    continue
                if occupied[row, to_col] or occupied[to_row, col]:
                    continue
                graph.add_edge(
                    (col, row), (to_col, to_row), weight=printed_cost(levels, [(col, row), (to_col, to_row)])
                )
    path = cheapest_path(occupied, rings, start, goal)
    assert printed_cost(levels, path) == pytest.approx(nx.bellman_ford_path_length(graph, start, goal))
    steps = np.abs(np.diff(path, axis=0)).sum(axis=1)
    assert np.where(steps == 2, 14, 10).sum() == plan.cost


def test_rings_leave_every_passage_open_and_growth_closes_the_narrow_ones():
    assert [narrowest("ea_star", n) for n in (1, 2, 3)] == [3, 3, 3]
    # 2 n + 1 cells are needed; 15, 9, 5 and 3 are tried.
    assert [narrowest(GROWN, n) for n in (1, 2, 3)] == [3, 5, 9]
