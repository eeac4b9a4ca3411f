"""A checked planner says nothing of sound plans, and names what is wrong with others."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import QuadlogError, UnknownName
from quadlog.planning.protocol import Plan
from quadlog.planning.registry import PLANNERS, CheckedPlanner, make_planner, planner_names, planner_type
from quadlog.planning.rules import USUAL, Rules
from quadlog.plugins import PLANNERS as GROUP
from quadlog.plugins import Plugin

PLUGIN = Plugin(GROUP, "odd", "quadlog-odd", "1.0", None)  # type: ignore[arg-type]


class Unreadable(Exception):
    def __str__(self):
        raise ValueError


FREE = np.zeros((6, 8), dtype=bool)


def answering(answer, rules: Rules = USUAL) -> CheckedPlanner:
    """A checked planner whose every plan is that of A*, as the function makes it."""

    class Odd:
        name, incremental = "odd", False

        def __init__(self, rules):
            self.rules = rules

        def plan(self, blocked, start, goal, shift=(0, 0)):
            return answer(make_planner("astar", self.rules).plan(blocked, start, goal))

        def reset(self):
            pass

    return CheckedPlanner(PLUGIN, Odd, rules)  # type: ignore[arg-type]


def fault_of(answer, blocked=FREE, start=(0, 0), goal=(7, 5), rules: Rules = USUAL) -> str:
    with pytest.raises(QuadlogError, match=r"odd of quadlog-odd 1\.0") as raised:
        answering(answer, rules).plan(blocked, start, goal)
    return str(raised.value)


@pytest.mark.parametrize("name", sorted(PLANNERS))
@given(
    seed=st.integers(0, 2**32),
    density=st.floats(0, 0.6),
    costs=st.sampled_from(["integer", "exact"]),
    corner_cutting=st.booleans(),
)
def test_quadlogs_own_plans_pass_unchanged(name, seed, density, costs, corner_cutting):
    rng = np.random.default_rng(seed)
    blocked = rng.random((7, 9)) < density
    start, goal = (tuple(rng.integers((9, 7)).tolist()) for _ in range(2))
    rules = Rules(costs=costs, corner_cutting=corner_cutting)
    checked = CheckedPlanner(PLUGIN, PLANNERS[name], rules)
    ours, theirs = make_planner(name, rules).plan(blocked, start, goal), checked.plan(blocked, start, goal)
    assert theirs.cells.dtype == np.int32
    np.testing.assert_array_equal(theirs.cells, ours.cells)
    assert theirs._replace(cells=ours.cells) == ours
    checked.reset()


def path_of(*cells, cost):
    return lambda _: Plan(True, np.array(cells), cost, 8, 8, 8, True, 0)


@pytest.mark.parametrize(
    "answer",
    [
        lambda plan: None,
        lambda plan: (True, plan.cells, 1),
        lambda plan: plan._replace(cells=None),
        lambda plan: plan._replace(cells=plan.cells.astype(float)),
        lambda plan: plan._replace(cells=plan.cells.ravel()),
        lambda plan: plan._replace(cells=[["a", "b"]]),
        lambda plan: plan._replace(cost="dear"),
        lambda plan: plan._replace(cost=1j),
        lambda plan: plan._replace(expanded=1.5),
        lambda plan: plan._replace(touched=-1),
        lambda plan: plan._replace(cells=plan.cells[:0]),
        lambda plan: plan._replace(cells=plan.cells[::-1]),
        lambda plan: plan._replace(cells=plan.cells[:-1]),
        lambda plan: plan._replace(cells=plan.cells[1:]),
        lambda plan: plan._replace(cells=plan.cells[[0, -1]]),
        lambda plan: plan._replace(cells=np.repeat(plan.cells, 2, axis=0)),
        lambda plan: plan._replace(cost=plan.cost + 1),
        lambda plan: plan._replace(cost=math.nan),
        path_of(
            (0, 0), (0, -1), (1, -1), (2, 0), (3, 1), (4, 2), (5, 3), (6, 4), (7, 5), cost=108
        ),  # leaves the window
    ],
)
def test_a_wrong_plan_is_refused(answer):
    fault_of(answer)


def test_a_path_through_an_obstacle_is_refused_and_cells_of_any_integers_are_taken():
    wall = FREE.copy()
    wall[:, 3] = True
    assert "free cells" in fault_of(path_of(*((col, 0) for col in range(8)), cost=70), blocked=wall, goal=(7, 0))
    plan = answering(lambda plan: plan._replace(cells=plan.cells.astype(np.int64).tolist())).plan(FREE, (0, 0), (7, 5))
    assert plan.cells.dtype == np.int32


@pytest.mark.parametrize("blocked_cell", [(0, 1), (1, 0)])
def test_a_cut_corner_is_refused_unless_the_rules_allow_it(blocked_cell):
    blocked = np.zeros((2, 2), dtype=bool)
    blocked[blocked_cell] = True
    plan = Plan(True, np.array([(0, 0), (1, 1)]), 14, 2, 2, 2, True, 0)
    assert "cuts a corner" in fault_of(lambda _: plan, blocked=blocked, goal=(1, 1))
    cutting = answering(lambda _: plan, Rules(corner_cutting=True))
    assert cutting.plan(blocked, (0, 0), (1, 1)).cost == 14


@pytest.mark.parametrize("kind", [KeyError, SystemExit, GeneratorExit, Unreadable])
def test_a_planner_neither_ends_quadlog_nor_hides_why_it_failed(kind):
    def fail(_):
        raise kind("no\nsuch cell")

    with pytest.raises(QuadlogError, match=kind.__name__) as raised:
        answering(fail).plan(FREE, (0, 0), (1, 1))
    assert isinstance(raised.value.__cause__, kind)
    assert "\n" not in str(raised.value)


GOOD = """
from quadlog.planning.planners.astar import AStar
class Mine(AStar):
    name = "mine"
"""


def test_a_plugins_planner_is_made_by_name(install):
    install("quadlog-mine", "1.0", {GROUP: {"mine": "mine:Mine"}}, {"mine": GOOD})
    assert planner_names() == (*PLANNERS, "mine")
    assert make_planner("mine", Rules(corner_cutting=True)).rules.corner_cutting
    assert make_planner("mine").plan(FREE, (0, 0), (7, 5)).cost == 90
    assert planner_type("mine").incremental is False
    with pytest.raises(UnknownName, match="ia_star_bounded, ia_star_end, lpa_star, mine, mt_d_star_lite"):
        make_planner("nobody")


@pytest.mark.parametrize(
    "source",
    [
        "Mine = 5",
        "class Mine: pass",
        GOOD.replace('"mine"', '"yours"'),
        GOOD + "    def __init__(self, rules): 1 / 0",
        GOOD + "    def __init__(self, rules): self.rules = 'mine'",
    ],
)
def test_what_is_no_planner_is_refused(install, source):
    install("quadlog-mine", "1.0", {GROUP: {"mine": "mine:Mine"}}, {"mine": source})
    with pytest.raises(QuadlogError, match="mine"):
        make_planner("mine")
