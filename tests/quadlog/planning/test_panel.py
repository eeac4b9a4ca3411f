from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from quadlog.mapping.grid import Window
from quadlog.planning.planners.astar import AStar
from quadlog.planning.protocol import no_plan
from quadlog.planning.query import NoQuery, Query
from quadlog.planning.registry import PLANNERS, make_planner
from quadlog.planning.replan import Panel, ReplanSettings, compile_planner
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
