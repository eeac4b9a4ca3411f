from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from quadlog.planning.planners.d_star_lite import DStarLite
from quadlog.planning.rules import COSTS, TIES, Rules

RULES = st.builds(Rules, costs=st.sampled_from(COSTS), ties=st.sampled_from(TIES), corner_cutting=st.booleans())


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.1, 0.25, 0.4]), RULES)
def test_optimal_while_the_goal_keeps_its_cell(assert_optimal_throughout, seed, density, rules):
    """What the planner is made for: the search before is used, on call after call."""
    moves = [{"map"}, {"map", "start"}, {"start"}, {"map"}, set(), {"window"}, {"start", "map"}, {"map", "window"}] * 2
    plans = assert_optimal_throughout(DStarLite(rules), seed, density, moves)
    assert not all(plan.from_scratch for plan in plans[1:])


def test_fresh_search_when_the_goal_moves_and_after_reset(forest):
    planner, blocked = DStarLite(), forest()
    planner.plan(blocked, (2, 2), (30, 35))
    assert planner.plan(blocked, *((2, 2), (30, 34))).from_scratch
    assert not planner.plan(blocked, *((2, 2), (30, 34))).from_scratch
    planner.reset()
    assert planner.plan(blocked, *((2, 2), (30, 34))).from_scratch


def test_robot_that_walks_its_path_expands_nothing(forest):
    blocked = forest()
    planner, path = DStarLite(), DStarLite().plan(blocked, (2, 2), (30, 35)).cells
    for i in range(len(path)):
        plan = planner.plan(blocked, (int(path[i, 0]), int(path[i, 1])), (30, 35))
        assert plan.found
        assert plan.expanded == 0 or i == 0
    assert plan.cost == 0
