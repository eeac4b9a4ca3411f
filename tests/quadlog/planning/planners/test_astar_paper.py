from __future__ import annotations

import numpy as np

from quadlog.planning.planners.astar import AStar, AStarPaper
from quadlog.planning.rules import Rules


def test_overrates_diagonal_ways(forest):
    """Fewer cells than A*, and at times a dearer path, here by no more than the heuristic overrates: 20 for 14."""
    dearer, printed, best = [], 0, 0
    for seed in range(40):
        blocked = forest(seed, 0.25)
        ours, cheapest = (each.plan(blocked, (2, 2), (30, 35)) for each in (AStarPaper(), AStar()))
        dearer.append(ours.cost / cheapest.cost)
        printed, best = printed + ours.expanded, best + cheapest.expanded
    assert 1 < max(dearer) <= 20 / 14
    assert printed < best


def test_open_ground_is_crossed_the_shortest_way():
    plan = AStarPaper().plan(np.zeros((30, 50), dtype=bool), (3, 5), (40, 25))
    assert plan.cost == 20 * 14 + 17 * 10


def test_keeps_its_heuristic_whatever_the_rules():
    assert AStarPaper().rules == AStarPaper(Rules(heuristic="zero")).rules == Rules(heuristic="manhattan")
