from __future__ import annotations

import numpy as np

from quadlog.planning.planners.astar import AStar
from quadlog.planning.planners.d_star_lite import MTDStarLite


def test_walk_along_the_path_expands_a_fraction_of_what_astar_does(forest):
    """Not nothing: beside the path are cells that come cheaper by f from the new start than they did from the old."""
    blocked, planner, expanded, afresh = forest(), MTDStarLite(), 0, 0
    path = [(int(col), int(row)) for col, row in planner.plan(blocked, (2, 2), (30, 35)).cells]
    for start in path[1:]:
        plan, best = planner.plan(blocked, start, (30, 35)), AStar().plan(blocked, start, (30, 35))
        assert not plan.from_scratch or start == path[-1]
        assert plan.cost == best.cost
        expanded, afresh = expanded + plan.expanded, afresh + best.expanded
    assert expanded < 0.5 * afresh


def test_fresh_search_where_the_one_before_never_was_and_after_reset():
    planner, blocked = MTDStarLite(), np.zeros((40, 40), dtype=bool)
    planner.plan(blocked, (20, 20), (30, 20))
    assert not planner.plan(blocked, (21, 20), (30, 20)).from_scratch
    assert planner.plan(blocked, (2, 35), (30, 20)).from_scratch
    planner.reset()
    assert planner.plan(blocked, (2, 35), (30, 20)).from_scratch
