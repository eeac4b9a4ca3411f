from __future__ import annotations

import numpy as np
import pytest

from quadlog.planning.planners.astar import AStar, AStarPaper, Dijkstra
from quadlog.planning.rules import COSTS, TIES, Rules


@pytest.mark.parametrize("costs", COSTS)
@pytest.mark.parametrize("ties", TIES)
@pytest.mark.parametrize("cutting", [False, True])
@pytest.mark.parametrize("seed", range(10))
def test_expands_all_below_the_optimum_and_some_at_it(costs_from, seed, costs, ties, cutting):
    """Cells whose best way is of f below the optimum must be closed, those above it never; at it, ties decide."""
    rules = Rules(costs=costs, ties=ties, corner_cutting=cutting)
    blocked = np.random.default_rng(seed).random((40, 40)) < 0.25
    start, goal = (0, 0), (39, 35)
    blocked[0, 0] = blocked[35, 39] = False
    plan, g = AStar(rules).plan(blocked, start, goal), costs_from(blocked, start, rules)
    if not plan.found:
        assert plan.expanded == plan.generated == np.isfinite(g).sum()
        return
    row, col = np.indices(blocked.shape)
    across, along = abs(col - goal[0]), abs(row - goal[1])
    straight, diagonal = (10, 14) if costs == "integer" else (1, np.sqrt(2))
    f = g + straight * abs(across - along) + diagonal * np.minimum(across, along)
    must, may = f < plan.cost - 1e-6, f < plan.cost + 1e-6
    must[plan.cells[:, 1], plan.cells[:, 0]] = True
    assert must.sum() <= plan.expanded <= may.sum()
    assert plan.expanded <= plan.generated <= np.isfinite(g).sum()


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


@pytest.mark.parametrize("ties", TIES)
@pytest.mark.parametrize("costs", COSTS)
@pytest.mark.parametrize("seed", range(5))
def test_dijkstra_expands_everything_that_is_nearer_than_the_goal(costs_from, seed, costs, ties):
    rules = Rules(costs=costs, ties=ties)
    blocked = np.random.default_rng(seed).random((30, 30)) < 0.2
    blocked[0, 0] = blocked[20, 25] = False
    plan, g = Dijkstra(rules).plan(blocked, (0, 0), (25, 20)), costs_from(blocked, (0, 0), rules)
    best = min(g[20, 25], 1e9)
    assert (g < best - 1e-6).sum() < plan.expanded + (not plan.found)
    assert plan.expanded <= (g < best + 1e-6).sum()


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
