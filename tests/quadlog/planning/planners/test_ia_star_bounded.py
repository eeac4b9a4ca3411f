from __future__ import annotations

from itertools import product

import numpy as np

from quadlog.planning.planners.astar import AStar
from quadlog.planning.planners.ia_star import MAX_EXCESS, IAStar, IAStarBounded


def walks(planner, seed):
    """A robot that walks its paths in a forest to a goal that wanders off: (plans, the cheapest ones)."""
    rng = np.random.default_rng(seed)
    blocked = rng.random((40, 40)) < 0.1
    goal, at = np.array([30, 8]), (2, 8)
    plans, best = [], []
    for _ in range(25):
        goal = np.clip(goal + rng.integers(-1, 3, 2), 0, 39)
        blocked[goal[1], goal[0]] = blocked[at[1], at[0]] = False
        query = blocked, at, (int(goal[0]), int(goal[1]))
        plans.append(planner.plan(*query))
        best.append(AStar().plan(*query))
        if plans[-1].found:
            at = tuple(plans[-1].cells[min(1, len(plans[-1].cells) - 1)].tolist())
    return plans, best


def test_the_bound_is_needed_and_heals():
    """IA* alone goes beyond it on the same walks; where it does not, the two are one."""
    worst = {IAStar: 0.0, IAStarBounded: 0.0}
    for planner, seed in product(worst, range(30)):
        ratios = [plan.cost / best.cost for plan, best in zip(*walks(planner(), seed), strict=True) if best.cost > 0]
        worst[planner] = max(worst[planner], *ratios)
    assert worst[IAStarBounded] <= MAX_EXCESS < worst[IAStar]
