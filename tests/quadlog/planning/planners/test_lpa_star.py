from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from quadlog.planning.planners.d_star_lite import LPAStar
from quadlog.planning.rules import COSTS, TIES, Rules

RULES = st.builds(Rules, costs=st.sampled_from(COSTS), ties=st.sampled_from(TIES), corner_cutting=st.booleans())


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.1, 0.25, 0.4]), RULES)
def test_optimal_while_the_start_keeps_its_cell(assert_optimal_throughout, seed, density, rules):
    """What the planner is made for: the search before is used, on call after call."""
    moves = [{"map"}, {"map", "goal"}, {"goal"}, {"map"}, set(), {"window"}, {"goal", "map"}, {"map", "window"}] * 2
    plans = assert_optimal_throughout(LPAStar(rules), seed, density, moves)
    assert not all(plan.from_scratch for plan in plans[1:])


def test_fresh_search_when_the_start_moves_and_after_reset(forest):
    planner, blocked = LPAStar(), forest()
    planner.plan(blocked, (2, 2), (30, 35))
    assert planner.plan(blocked, *((2, 3), (30, 35))).from_scratch
    assert not planner.plan(blocked, *((2, 3), (30, 35))).from_scratch
    planner.reset()
    assert planner.plan(blocked, *((2, 3), (30, 35))).from_scratch
