from __future__ import annotations

import numpy as np

from quadlog.planning.planners.astar import AStar, AStarPaper
from quadlog.planning.rules import TIES, Rules


def test_ties_decide_what_open_ground_costs():
    blocked = np.zeros((100, 100), dtype=bool)
    plan, published = (AStar(Rules(ties=ties)).plan(blocked, (3, 5), (90, 60)) for ties in TIES)
    assert plan.expanded == len(plan.cells) == 88
    assert plan.cost == published.cost == 55 * 14 + 32 * 10
    # All cells of the parallelogram that cheapest ways go through.
    assert published.expanded > 33 * 50


def test_counts_of_a_single_step():
    plan = AStar().plan(np.zeros((3, 3), dtype=bool), (1, 1), (2, 1))
    assert (plan.expanded, plan.generated, plan.touched) == (2, 9, 8)


def test_the_papers_heuristic_overrates_diagonal_ways(forest):
    """Fewer cells than A*, and at times a dearer path, here by no more than the heuristic overrates: 20 for 14."""
    dearer, printed, best = [], 0, 0
    for seed in range(40):
        blocked = forest(seed, 0.25)
        ours, cheapest = (each.plan(blocked, (2, 2), (30, 35)) for each in (AStarPaper(), AStar()))
        dearer.append(ours.cost / cheapest.cost)
        printed, best = printed + ours.expanded, best + cheapest.expanded
    assert 1 < max(dearer) <= 20 / 14
    assert printed < best
