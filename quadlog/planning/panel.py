"""Several planners who are asked the same questions, one after the other, and what each of them answered."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadlog.mapping.window import Window
from quadlog.messages import Float
from quadlog.planning.astar import AStar
from quadlog.planning.polyline import largest_curvature, turning
from quadlog.planning.protocol import Bool, Cell, Cells, Plan, Planner, is_usable, no_plan
from quadlog.planning.query import NoQuery, Query
from quadlog.planning.smoothing import smooth_path


@dataclass(frozen=True, slots=True)
class Smoothing:
    """See smooth_path."""

    merge_m: float = 0.3
    spacing_m: float = 0.05


@dataclass(frozen=True, slots=True)
class Answer:
    """What a planner answered. why_not is empty when it found a path, "missed" when there was one that it did not find.

    optimal_cost: of the cheapest path there is, NaN where there is none. us: microseconds in the planner, NaN when it
    was not asked. length_m and turn_rad: of the path on the grid, turn_rad the sum of its changes of heading.
    curvature_max_1pm: of the smoothed path, NaN where none was asked for.
    """

    planner: str
    plan: Plan
    why_not: str
    optimal_cost: float
    us: float
    length_m: float
    turn_rad: float
    curvature_max_1pm: float


class Panel:
    """Asks its planners in turns, so that none is always the one that finds the map in the processor's cache.

    smoothing: None leaves curvatures out.
    """

    def __init__(self, planners: Sequence[Planner], smoothing: Smoothing | None) -> None:
        self._planners = planners
        self._smoothing = smoothing
        self._reference = AStar(planners[0].rules)
        self._last_window: Window | None = None
        self._asked = 0
        for planner in planners:
            compile_planner(planner)

    def begin_episode(self) -> None:
        """What comes next has nothing to do with what was before."""
        self._last_window = None
        for planner in self._planners:
            planner.reset()

    def ask(self, query: Query | NoQuery) -> list[Answer]:
        """Every planner's answer, in the order of the planners."""
        if isinstance(query, NoQuery):
            return [
                Answer(each.name, no_plan(), query.why, math.nan, math.nan, math.nan, math.nan, math.nan)
                for each in self._planners
            ]
        shift = (0, 0) if self._last_window is None else self._last_window.shift_to(query.window)
        self._last_window = query.window
        optimum = self._reference.plan(query.blocked, query.start, query.goal)
        self._asked += 1
        count, answers = len(self._planners), {}
        for turn in range(count):
            at = (self._asked + turn) % count
            answers[at] = self._ask_one(self._planners[at], query, shift, optimum)
        return [answers[at] for at in range(count)]

    def _ask_one(self, planner: Planner, query: Query, shift: Cell, optimum: Plan) -> Answer:
        began_ns = time.perf_counter_ns()
        plan = planner.plan(query.blocked, query.start, query.goal, shift)
        microseconds = (time.perf_counter_ns() - began_ns) / 1000
        optimal_cost = optimum.cost if optimum.found else math.nan
        if not plan.found:
            why_not = "missed" if optimum.found else why_no_path(query.blocked, query.start, query.goal)
            return Answer(planner.name, plan, why_not, optimal_cost, microseconds, math.nan, math.nan, math.nan)
        length_m, turn_rad = turning(plan.cells * query.window.cell_m)
        curvature = self._curvature(query, plan.cells)
        return Answer(planner.name, plan, "", optimal_cost, microseconds, length_m, turn_rad, curvature)

    def _curvature(self, query: Query, cells: Cells) -> float:
        if self._smoothing is None:
            return math.nan
        window = query.window
        path_m: Float = window.centre_of(cells)
        merge_m, spacing_m = self._smoothing.merge_m, self._smoothing.spacing_m
        return largest_curvature(smooth_path(path_m, merge_m, spacing_m, query.blocked, window.origin_m, window.cell_m))


def compile_planner(planner: Planner) -> None:
    """Compiles, or loads from cache, what the first plan would otherwise be charged for.

    The second start lies beside the first path, so that re-anchoring is compiled as well.
    """
    for start in ((0, 0), (1, 0)):
        planner.plan(np.zeros((3, 3), dtype=bool), start, (2, 2))
    planner.reset()


def why_no_path(blocked: Bool, start: Cell, goal: Cell) -> str:
    """In two words, for a query that has no answer."""
    for name, (col, row) in (("start", start), ("goal", goal)):
        if not (0 <= row < blocked.shape[0] and 0 <= col < blocked.shape[1]):
            return f"{name} outside"
        if not is_usable(blocked, (col, row)):
            return f"{name} blocked"
    return "unreachable"
