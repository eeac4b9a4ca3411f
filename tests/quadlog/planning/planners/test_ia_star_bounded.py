from __future__ import annotations

from itertools import product

import numpy as np

from quadlog.planning.planners import ia_star as ia_star_bounded
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


def test_both_searches_are_counted(monkeypatch, forest):
    """With a bound that no way round an obstacle keeps."""
    monkeypatch.setattr(ia_star_bounded, "MAX_EXCESS", 1.0)
    planner, plain, query = IAStarBounded(), IAStar(), (forest(), (2, 2), (30, 35))
    fresh = planner.plan(*query)
    plain.plan(*query)
    ours, kept = planner.plan(*query), plain.plan(*query)
    assert fresh.cost > 28 * 14 + 5 * 10
    assert not kept.from_scratch
    assert ours.from_scratch
    assert (ours.cost, ours.reused_cells) == (fresh.cost, 0)
    for count in ("expanded", "generated", "touched"):
        assert getattr(ours, count) == getattr(kept, count) + getattr(fresh, count) > getattr(kept, count)


def test_the_next_plan_extends_the_one_found_afresh(monkeypatch, forest):
    extended, other = 0, 0
    for seed in range(20):
        planner, plain, blocked = IAStarBounded(), IAStar(), forest(seed, 0.25)
        for each in (planner, plain):
            each.plan(blocked, (2, 2), (30, 34))
        with monkeypatch.context() as patched:
            patched.setattr(ia_star_bounded, "MAX_EXCESS", 1.0)
            fresh, kept = (each.plan(blocked, (2, 2), (30, 35)) for each in (planner, plain))
        if fresh.found and fresh.from_scratch:
            plan = planner.plan(blocked, (2, 2), (30, 35))
            reused = plan.reused_cells
            np.testing.assert_array_equal(plan.cells[:reused], fresh.cells[:reused])
            extended += reused > 0
            other += (plan.cells[:reused] != kept.cells[:reused]).any()
    assert extended > 5
    assert other > 0


def test_what_is_short_enough_is_kept(forest):
    planner, blocked = IAStarBounded(), forest()
    assert planner.plan(blocked, (2, 2), (30, 35)).from_scratch
    again = planner.plan(blocked, (2, 2), (30, 35))
    assert not again.from_scratch
    assert again.reused_cells > 0
