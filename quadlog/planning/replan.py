"""Planners asked on one window after another, and one replan from a map to a path that can be walked: the same for
replays, re-simulated walks, walks through worlds and comparisons.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from quadlog.geometry import arc_lengths
from quadlog.mapping.grid import Window
from quadlog.messages import Float
from quadlog.planning.path import resample, smooth_path, straight_path
from quadlog.planning.planners.astar import AStar
from quadlog.planning.protocol import Bool, Plan, Planner, no_plan
from quadlog.planning.query import Growth, NoQuery, Query, make_query
from quadlog.planning.registry import CheckedPlanner
from quadlog.planning.settings import SmoothingSettings


class Asker:
    """Asks a planner on one window after another, with how the window moved between them, and takes the time."""

    def __init__(self, planner: Planner) -> None:
        self.planner = planner
        # Compile, or load from cache, what the first plan would otherwise be charged for. The second start lies beside
        # the first path, so that re-anchoring is compiled as well.
        for start in ((0, 0), (1, 0)):
            planner.plan(np.zeros((3, 3), dtype=bool), start, (2, 2))
        self.forget()

    def forget(self) -> None:
        """Whatever is asked next has nothing to do with what was asked before."""
        self._last: Window | None = None
        self.planner.reset()

    def ask(self, query: Query | NoQuery) -> tuple[Plan, float]:
        """(the planner's answer, the microseconds that it took), NaN where there is nothing to plan.

        The check of a plug-in's answer does not count. After another cell size the planner starts afresh.
        """
        if isinstance(query, NoQuery):
            return no_plan(), math.nan
        if self._last is not None and self._last.cell_m != query.window.cell_m:
            self.forget()
        shift = (0, 0) if self._last is None else self._last.shift_to(query.window)
        self._last, asked = query.window, (query.blocked, query.start, query.goal)
        plugin = self.planner if isinstance(self.planner, CheckedPlanner) else None
        plan = plugin.unchecked if plugin else self.planner.plan
        began_ns = time.perf_counter_ns()
        answer = plan(*asked, shift)
        us = (time.perf_counter_ns() - began_ns) / 1000
        return (plugin.checked(answer, *asked) if plugin else answer), us


class Panel:
    """Asks planners in turns, so that none is always the one that finds the map in the processor's cache.

    rounds: the planners, and doubles of them in the same order, which are asked the same in further rounds for their
    times alone: what an incremental planner remembers from one question to the next is then the same in each round.
    """

    def __init__(self, rounds: Sequence[Sequence[Planner]]) -> None:
        self._rounds = [[Asker(planner) for planner in planners] for planners in rounds]
        self._reference, self._asked = Asker(AStar(rounds[0][0].rules)), 0

    def begin_episode(self) -> None:
        """See Asker.forget."""
        for asker in chain(*self._rounds):
            asker.forget()

    def ask(self, query: Query | NoQuery) -> tuple[Plan, list[Plan], Float]:
        """(the optimum by the first planner's rules, each planner's plan, microseconds (planners, rounds))."""
        count, plans = len(self._rounds[0]), dict[int, Plan]()
        us = np.empty((count, len(self._rounds)))
        for number, askers in enumerate(self._rounds):
            self._asked += 1
            for turn in range(count):
                at = (self._asked + turn) % count
                plan, us[at, number] = askers[at].ask(query)
                plans.setdefault(at, plan)
        return self._reference.ask(query)[0], [plans[at] for at in range(count)], us


Row = dict[str, Any]
"""The columns of plans.parquet."""


@dataclass(frozen=True, slots=True)
class PlannedPath:
    """The rows of paths.parquet of one replan: both (K, 2) in map, row i at the same fraction of each one's length.

    smooth_xy_m is what the robot follows; raw_xy_m is the path before smoothing.
    """

    t_ns: int
    raw_xy_m: Float
    smooth_xy_m: Float


@dataclass(frozen=True, slots=True)
class Replan:
    """What one replan gives; path is None when no way was found, query where there was nothing to plan.

    row: costs and length_m are NaN when no path was found; length_m is that of the path before
    smoothing, as far as it is to be walked. The goal is the point planned to: the target, or the centre of the cell
    that stands for it. us: microseconds in the planner alone, NaN when it was not asked, see NoQuery.
    astar_expanded: cells that A* closes on the same query.
    """

    row: Row
    astar_expanded: int
    path: PlannedPath | None
    query: Query | None


class Replanner:
    """Replans on one map after another.

    growth: of obstacles. stop_short_m: the path ends so far from the goal, 0 to reach it.
    """

    def __init__(
        self, planner: Planner, growth: Growth, stop_short_m: float = 0.0, smoothing: SmoothingSettings | None = None
    ) -> None:
        self._asker, self._reference = Asker(planner), Asker(AStar(planner.rules))
        self.growth, self._stop_short_m, self._smoothing = growth, stop_short_m, smoothing or SmoothingSettings()

    def restart(self) -> None:
        """See Asker.forget."""
        self._asker.forget()

    def replan(self, t_ns: int, window: Window, occupied: Bool, start_xy_m: Float, goal_xy_m: Float) -> Replan:
        """From the robot at start_xy_m (2,) towards goal_xy_m (2,), on occupied (rows, cols) of the window, in map.

        See make_query. Raises ValueError for a start that is not finite.
        """
        query = make_query(window, occupied, start_xy_m, goal_xy_m, self.growth)
        plan, us = self._asker.ask(query)
        # Exact type: subclasses change the heuristic.
        optimum = plan if type(self._asker.planner) is AStar else self._reference.ask(query)[0]
        known = None if isinstance(query, NoQuery) else query
        is_projected = known is not None and known.goal_projected
        goal_m = window.centre_of(np.array(known.goal)) if known is not None and is_projected else goal_xy_m
        path, length_m = None, math.nan
        if known is not None and plan.found:
            raw_m = _stopped_short(_walkable(plan, known, start_xy_m, goal_m), goal_xy_m, self._stop_short_m)
            path, length_m = self._path(t_ns, raw_m, known), float(arc_lengths(raw_m)[-1])
        row = {
            "t_ns": t_ns,
            "planner": self._asker.planner.name,
            "found": plan.found,
            "expanded": plan.expanded,
            "generated": plan.generated,
            "cost": plan.cost if plan.found else math.nan,
            "length_m": length_m,
            "optimal_cost": optimum.cost if optimum.found else math.nan,
            "from_scratch": plan.from_scratch,
            "reused_cells": plan.reused_cells,
            **dict(zip(("start_x_m", "start_y_m", "goal_x_m", "goal_y_m"), (*start_xy_m, *goal_m), strict=True)),
            "goal_projected": is_projected,
            "us": us,
        }
        return Replan(row, optimum.expanded, path, known)

    def _path(self, t_ns: int, raw_m: Float, query: Query) -> PlannedPath:
        how, window, blocked = self._smoothing, query.window, query.blocked
        if how.enabled:
            if len(query.way_out):
                blocked = blocked.copy()
                blocked[query.way_out[:, 1], query.way_out[:, 0]] = False
            smooth_m = smooth_path(raw_m, how.merge_m, how.spacing_m, blocked, window.origin_m, window.cell_m)
        else:
            smooth_m = straight_path(raw_m, how.spacing_m)
        return PlannedPath(t_ns, resample(raw_m, len(smooth_m)), smooth_m)


def _walkable(plan: Plan, query: Query, start_xy_m: Float, goal_xy_m: Float) -> Float:
    """The path (L, 2) in map from where the robot really is over the cells' centres to the goal point."""
    points_m = query.window.centre_of(np.concatenate([query.way_out, plan.cells]))
    if len(points_m) == 1:
        return np.array([start_xy_m, goal_xy_m], dtype=np.float64)
    points_m[0] = start_xy_m
    points_m[-1] = goal_xy_m
    return points_m


def _stopped_short(points_m: Float, goal_xy_m: Float, stop_short_m: float) -> Float:
    """The path (L, 2) without its last stretch nearer than stop_short_m to the goal; one point when that is all of it.

    Cut from the end, not where the path first comes near: it may pass the goal behind a wall.
    """
    away_m = np.hypot(*(points_m - goal_xy_m).T)
    far_enough = np.flatnonzero(away_m >= stop_short_m)
    if len(far_enough) == 0:
        return points_m[:1]
    last = int(far_enough[-1])
    if last == len(points_m) - 1:
        return points_m
    # The circle is crossed between `last` and the next point: solve |outside + s step - goal| = stop_short_m.
    outside, step = points_m[last] - goal_xy_m, points_m[last + 1] - points_m[last]
    a, b, c = step @ step, outside @ step, outside @ outside - stop_short_m**2
    s = (-b - math.sqrt(max(b * b - a * c, 0.0))) / a
    return np.concatenate([points_m[: last + 1], [points_m[last] + s * step]])
