from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from quadlog.mapping.grid import Window
from quadlog.planning.planners.astar import AStar
from quadlog.planning.planners.ia_star import IAStar
from quadlog.planning.protocol import no_plan
from quadlog.planning.query import NoQuery, Query
from quadlog.planning.registry import PLANNERS, make_planner
from quadlog.planning.replan import Panel, ReplanSettings, compile_planner, why_no_path
from quadlog.planning.rules import Rules

NO_CELLS = np.empty((0, 2), dtype=np.int32)


def query_on(blocked, start, goal, corner=(0, 0), cell_m=0.5) -> Query:
    return Query(Window(*corner, cell_m, blocked.shape), blocked, start, goal, False, NO_CELLS)


class Watched(AStar):
    """Notes what it is asked, and finds nothing when blind."""

    def __init__(self, name: str, calls: list, blind: bool = False) -> None:
        super().__init__(Rules())
        self.name, self.calls, self.blind = name, calls, blind  # type: ignore[misc]

    def plan(self, blocked, start, goal, shift=(0, 0)):
        self.calls.append((self.name, shift))
        return no_plan() if self.blind else super().plan(blocked, start, goal, shift)

    def reset(self) -> None:
        self.calls.append((self.name, "reset"))


def test_answers_are_in_the_order_of_the_planners_who_take_turns_to_begin():
    calls: list = []
    panel = Panel([Watched(name, calls) for name in "abc"], None)
    calls.clear()
    query = query_on(np.zeros((4, 4), dtype=bool), (0, 0), (3, 3))
    for _ in range(6):
        assert [each.planner for each in panel.ask(query)] == ["a", "b", "c"]
    firsts = [name for name, _ in calls[::3]]
    assert sorted(firsts) == list("aabbcc")
    assert all(sorted(name for name, _ in calls[i : i + 3]) == list("abc") for i in range(0, 18, 3))


def test_doubles_are_asked_the_same_in_rounds_of_their_own():
    calls: list = []
    panel = Panel([Watched(name, calls) for name in "ab"], None, [[Watched(name, calls) for name in "ab"]] * 2)
    calls.clear()
    panel.begin_episode()
    query = query_on(np.zeros((4, 4), dtype=bool), (0, 0), (3, 3))
    answers = panel.ask(query)
    asked = [name for name, what in calls if what != "reset"]
    assert [sorted(asked[i : i + 2]) for i in (0, 2, 4)] == [["a", "b"]] * 3
    assert asked[0] != asked[2]  # turns go on from round to round
    for answer in answers:
        assert len(answer.us_repeats) == 3
        assert answer.us == sorted(answer.us_repeats)[1]


def test_an_incremental_planner_does_the_same_work_in_every_round():
    """Its doubles remember their own plans, so that a repeat is no answer by heart."""
    blocked = np.random.default_rng(4).random((40, 40)) < 0.2
    blocked[0, :3] = blocked[39, 39] = False
    work: list[list[int]] = [[], [], []]

    class Noted(IAStar):
        def __init__(self, number: int) -> None:
            super().__init__()
            self.number = number

        def plan(self, blocked, start, goal, shift=(0, 0)):
            plan = super().plan(blocked, start, goal, shift)
            work[self.number].append(plan.expanded)
            return plan

    panel = Panel([Noted(0)], None, [[Noted(1)], [Noted(2)]])
    for each in work:
        each.clear()
    for start in ((0, 0), (1, 0), (2, 0)):
        panel.ask(query_on(blocked, start, (39, 39)))
    assert work[0] == work[1] == work[2]
    assert len(work[0]) == 3


def test_planners_hear_how_the_window_moved_and_forget_between_episodes():
    calls: list = []
    panel = Panel([Watched("a", calls)], None)
    assert calls[-1] == ("a", "reset")  # what was planned to compile it is forgotten
    calls.clear()
    blocked = np.zeros((4, 4), dtype=bool)
    panel.begin_episode()
    panel.ask(query_on(blocked, (0, 0), (3, 3), (10, 20)))
    panel.ask(NoQuery("walled in"))
    panel.ask(query_on(blocked, (0, 0), (3, 3), (12, 19)))
    panel.begin_episode()
    panel.ask(query_on(blocked, (0, 0), (3, 3), (50, 50)))
    assert calls == [("a", "reset"), ("a", (0, 0)), ("a", (2, -1)), ("a", "reset"), ("a", (0, 0))]


def test_a_question_that_could_not_be_asked_is_answered_by_nobody():
    calls: list = []
    panel = Panel([Watched("a", calls), Watched("b", calls)], ReplanSettings())
    calls.clear()
    answers = panel.ask(NoQuery("walled in"))
    assert calls == []
    assert [(each.why_not, each.plan.found) for each in answers] == [("walled in", False)] * 2
    assert all(math.isnan(getattr(answers[0], name)) for name in ("us", "optimal_cost", "length_m", "turn_rad"))


def test_a_way_that_a_planner_did_not_find_is_missed_not_unreachable():
    panel = Panel([Watched("a", []), Watched("b", [], blind=True)], None)
    sighted, blind = panel.ask(query_on(np.zeros((4, 4), dtype=bool), (0, 0), (3, 3)))
    assert (sighted.why_not, blind.why_not) == ("", "missed")
    assert blind.optimal_cost == sighted.plan.cost == 42
    wall = np.zeros((4, 4), dtype=bool)
    wall[:, 2] = True
    for answer in panel.ask(query_on(wall, (0, 0), (3, 3))):
        assert answer.why_not == "unreachable"
        assert math.isnan(answer.optimal_cost)


@pytest.mark.parametrize(
    ("start", "goal", "why"),
    [
        ((-1, 0), (1, 1), "start outside"),
        ((0, 0), (0, 3), "goal outside"),
        ((2, 0), (0, 0), "start blocked"),
        ((0, 0), (2, 0), "goal blocked"),
        ((0, 0), (1, 1), "unreachable"),
    ],
)
def test_why_no_path(start, goal, why):
    assert why_no_path(np.array([[False, True, True], [True, False, False]]), start, goal) == why


def test_lengths_and_turns_are_of_the_path_in_metres():
    """Two steps right, a diagonal, one up: 2 + root of 2 + 1 cells, two turns of an eighth."""
    blocked = np.ones((3, 4), dtype=bool)
    blocked[0, :3] = blocked[1, 2:] = blocked[2, 3] = blocked[0, 3] = False
    panel = Panel([make_planner("astar")], ReplanSettings())
    (answer,) = panel.ask(query_on(blocked, (0, 0), (3, 2), (7, -3)))
    steps = np.diff(answer.plan.cells, axis=0)
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    assert answer.length_m == pytest.approx(0.5 * np.hypot(*steps.T).sum()) == pytest.approx(0.5 * (3 + math.sqrt(2)))
    assert answer.turn_rad == pytest.approx(np.abs(np.diff(heading)).sum()) == pytest.approx(math.pi / 2)
    assert answer.curvature_max_1pm > 0
    (plain,) = Panel([make_planner("astar")], None).ask(query_on(blocked, (0, 0), (3, 2)))
    assert math.isnan(plain.curvature_max_1pm)


def test_the_optimum_is_by_the_planners_costs_whatever_their_heuristic():
    blocked = np.random.default_rng(3).random((20, 20)) < 0.2
    blocked[0, 0] = blocked[19, 19] = False
    for costs in ("integer", "exact"):
        rules = Rules(costs=costs, heuristic="manhattan")
        query = query_on(blocked, (0, 0), (19, 19))
        optimum = make_planner("dijkstra", rules).plan(blocked, (0, 0), (19, 19)).cost
        assert optimum > 0
        for answer in Panel([make_planner(name, rules) for name in ("astar_paper", "ia_star")], None).ask(query):
            assert answer.optimal_cost == pytest.approx(optimum, rel=1e-12)


@pytest.mark.parametrize("name", PLANNERS)
def test_compiling_leaves_no_trace(name):
    blocked = np.random.default_rng(5).random((12, 12)) < 0.2
    blocked[0, 0] = blocked[11, 11] = False
    fresh, compiled = make_planner(name), make_planner(name)
    compile_planner(compiled)
    first, second = (each.plan(blocked, (0, 0), (11, 11)) for each in (fresh, compiled))
    assert_array_equal(first.cells, second.cells)
    assert first[2:] == second[2:]
    assert second.from_scratch
