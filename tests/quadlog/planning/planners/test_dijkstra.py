from __future__ import annotations

import numpy as np
import pytest

from quadlog.planning.planners.astar import Dijkstra
from quadlog.planning.rules import COSTS, TIES, Rules


@pytest.mark.parametrize("ties", TIES)
@pytest.mark.parametrize("costs", COSTS)
@pytest.mark.parametrize("seed", range(5))
def test_expands_everything_that_is_nearer_than_the_goal(costs_from, seed, costs, ties):
    rules = Rules(costs=costs, ties=ties)
    blocked = np.random.default_rng(seed).random((30, 30)) < 0.2
    blocked[0, 0] = blocked[20, 25] = False
    plan, g = Dijkstra(rules).plan(blocked, (0, 0), (25, 20)), costs_from(blocked, (0, 0), rules)
    best = min(g[20, 25], 1e9)
    assert (g < best - 1e-6).sum() < plan.expanded + (not plan.found)
    assert plan.expanded <= (g < best + 1e-6).sum()


def test_keeps_its_heuristic_whatever_the_rules():
    assert Dijkstra(Rules(heuristic="octile")).rules == Rules(heuristic="zero")
