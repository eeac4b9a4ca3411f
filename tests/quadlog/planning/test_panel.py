"""Planners asked on one window after another: with how it moved, in turns, each timed by itself."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

from quadlog.mapping.grid import Window
from quadlog.planning.planners.astar import AStar
from quadlog.planning.query import NoQuery, Query
from quadlog.planning.registry import PLANNERS, make_planner
from quadlog.planning.replan import Asker, Panel
from quadlog.planning.rules import Rules

FREE = np.zeros((4, 4), dtype=bool)


def query(blocked=FREE, corner=(0, 0), cell_m=0.5) -> Query:
    """From one corner of a window to the other."""
    goal = blocked.shape[1] - 1, blocked.shape[0] - 1
    return Query(Window(*corner, cell_m, blocked.shape), blocked, (0, 0), goal, False, np.empty((0, 2), np.int32))


class Watched(AStar):
    """Notes what it is asked."""

    def __init__(self, name: str, calls: list) -> None:
        super().__init__(Rules())
        self.name, self.calls = name, calls  # type: ignore[misc]

    def plan(self, blocked, start, goal, shift=(0, 0)):
        self.calls.append((self.name, shift))
        return super().plan(blocked, start, goal, shift)

    def reset(self) -> None:
        self.calls.append((self.name, "reset"))


def test_a_planner_hears_how_the_window_moved_and_forgets_between_episodes_and_sizes_of_cells():
    calls: list = []
    panel = Panel([[Watched("a", calls)]])
    assert calls[-1] == ("a", "reset")  # what was planned to compile it is forgotten
    calls.clear()
    for corner, cell_m in (((10, 20), 0.5), (None, 0.5), ((12, 19), 0.5), ((12, 19), 0.25), ((13, 19), 0.25)):
        panel.ask(query(corner=corner, cell_m=cell_m) if corner else NoQuery("walled in"))
    panel.begin_episode()
    panel.ask(query(corner=(50, 50)))
    heard = [(0, 0), (2, -1), "reset", (0, 0), (1, 0), "reset", (0, 0)]
    assert calls == [("a", each) for each in heard]


def test_planners_take_turns_to_begin_and_doubles_are_asked_in_rounds_of_their_own():
    calls: list = []
    panel = Panel([[Watched(name, calls) for name in "abc"] for _ in range(2)])
    calls.clear()
    for _ in range(3):
        optimum, plans, us = panel.ask(query())
        assert (optimum.cost, [plan.cost for plan in plans], us.shape) == (42, [42] * 3, (3, 2))
    asked = [name for name, _ in calls]
    assert sorted(asked[::3]) == list("aabbcc")
    assert all(sorted(asked[i : i + 3]) == list("abc") for i in range(0, 18, 3))


def test_a_question_that_could_not_be_asked_is_answered_by_nobody():
    calls: list = []
    panel = Panel([[Watched("a", calls), Watched("b", calls)]])
    calls.clear()
    optimum, plans, us = panel.ask(NoQuery("walled in"))
    assert (calls, optimum.found, [plan.found for plan in plans]) == ([], False, [False] * 2)
    assert np.isnan(us).all()


@pytest.mark.parametrize("name", PLANNERS)
def test_what_compiles_a_planner_leaves_no_trace(name):
    blocked = np.random.default_rng(5).random((12, 12)) < 0.2
    blocked[0, 0] = blocked[11, 11] = False
    fresh = make_planner(name).plan(blocked, (0, 0), (11, 11))
    plan, us = Asker(make_planner(name)).ask(query(blocked))
    np.testing.assert_array_equal(plan.cells, fresh.cells)
    assert plan._replace(cells=fresh.cells) == fresh
    assert (plan.from_scratch, us > 0) == (True, True)


SLOW_TO_CHECK = """
import time
from quadlog.planning.planners.astar import AStar
class Cells:
    def __init__(self, cells): self.cells = cells
    def __array__(self, *_, **__):
        time.clock_ns += 10**9
        return self.cells
class Mine(AStar):
    name = "mine"
    def plan(self, *asked):
        time.clock_ns += 7000
        plan = super().plan(*asked)
        return plan._replace(cells=Cells(plan.cells))
"""


def test_the_check_of_a_plugin_is_not_in_its_time(install, monkeypatch):
    monkeypatch.setattr(time, "clock_ns", 0, raising=False)
    monkeypatch.setattr(time, "perf_counter_ns", lambda: time.clock_ns)
    install("quadlog-mine", "1.0", {"quadlog.planners": {"mine": "mine:Mine"}}, {"mine": SLOW_TO_CHECK})
    plan, us = Asker(make_planner("mine")).ask(query())
    assert (plan.cost, us) == (42, 7.0)
    assert math.isnan(Asker(make_planner("mine")).ask(NoQuery("no goal"))[1])
