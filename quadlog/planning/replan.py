"""One replan, from a map to a path that can be walked: the same for the logged walk and the re-simulated one."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from quadlog.mapping.window import Window
from quadlog.messages import Float
from quadlog.planning.astar import AStar
from quadlog.planning.panel import compile_planner
from quadlog.planning.polyline import arc_lengths, resample
from quadlog.planning.protocol import Bool, Cell, Plan, Planner, no_plan
from quadlog.planning.query import NoQuery, Query, make_query
from quadlog.planning.smoothing import smooth_path, straight_path


@dataclass(frozen=True, slots=True)
class ReplanSettings:
    """How a map becomes a path.

    dilation_m: obstacles grow by this; dilation: of `inflation.INFLATIONS`.
    stop_short_m: the path ends so far from the goal, 0 to reach it.
    smooth, merge_m, spacing_m: see smooth_path.
    """

    dilation_m: float = 0.3
    dilation: str = "euclidean"
    stop_short_m: float = 1.0
    smooth: bool = True
    merge_m: float = 0.3
    spacing_m: float = 0.05


@dataclass(frozen=True, slots=True)
class PlanRecord:
    """A row of plans.parquet, and A*'s counts on the same query.

    cost and optimal_cost are None, length_m is NaN, when no path was found.
    length_m is that of the path before smoothing, as far as it is to be walked.
    The goal is the point planned to: the target, or the centre of the cell that stands for it.
    us: microseconds in the planner alone, NaN when it was not asked because the robot is walled in.
    """

    t_ns: int
    planner: str
    found: bool
    expanded: int
    generated: int
    cost: float | None
    length_m: float
    optimal_cost: float | None
    from_scratch: bool
    reused_cells: int
    start_x_m: float
    start_y_m: float
    goal_x_m: float
    goal_y_m: float
    goal_projected: bool
    us: float
    astar_expanded: int
    astar_generated: int


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
    """What one replan gives; path is None when no way was found."""

    record: PlanRecord
    path: PlannedPath | None


class Replanner:
    """Replans on one map after another, and tells an incremental planner how the window moved between them."""

    def __init__(self, planner: Planner, settings: ReplanSettings) -> None:
        self._planner = planner
        self._settings = settings
        self._reference = AStar(planner.rules)
        self._last_window: Window | None = None
        compile_planner(planner)

    def replan(self, t_ns: int, window: Window, occupied: Bool, start_xy_m: Float, goal_xy_m: Float) -> Replan:
        """From the robot at start_xy_m (2,) towards goal_xy_m (2,), on occupied (rows, cols) of the window, in map.

        See make_query. Raises ValueError for a start that is not finite.
        """
        settings = self._settings
        query = make_query(window, occupied, start_xy_m, goal_xy_m, settings.dilation_m, settings.dilation)
        if isinstance(query, NoQuery):
            plan = optimum = no_plan()
            return Replan(self._record(t_ns, plan, optimum, start_xy_m, goal_xy_m, False, math.nan, math.nan), None)
        began_ns = time.perf_counter_ns()
        plan = self._planner.plan(query.blocked, query.start, query.goal, self._shift_to(window))
        microseconds = (time.perf_counter_ns() - began_ns) / 1000
        self._last_window = window
        # Not those derived from it, whose heuristic is another.
        is_reference = type(self._planner) is AStar
        optimum = plan if is_reference else self._reference.plan(query.blocked, query.start, query.goal)

        goal_m = window.centre_of(np.array(query.goal)) if query.goal_projected else goal_xy_m
        path, length_m = None, math.nan
        if plan.found:
            raw_m = _walkable(plan, query, window, start_xy_m, goal_m)
            raw_m = _stopped_short(raw_m, goal_xy_m, self._settings.stop_short_m)
            path, length_m = self._path(t_ns, raw_m, query, window), float(arc_lengths(raw_m)[-1])
        record = self._record(t_ns, plan, optimum, start_xy_m, goal_m, query.goal_projected, length_m, microseconds)
        return Replan(record, path)

    def _record(
        self,
        t_ns: int,
        plan: Plan,
        optimum: Plan,
        start_m: Float,
        goal_m: Float,
        goal_projected: bool,
        length_m: float,
        microseconds: float,
    ) -> PlanRecord:
        return PlanRecord(
            t_ns=t_ns,
            planner=self._planner.name,
            found=plan.found,
            expanded=plan.expanded,
            generated=plan.generated,
            cost=plan.cost if plan.found else None,
            length_m=length_m,
            optimal_cost=optimum.cost if optimum.found else None,
            from_scratch=plan.from_scratch,
            reused_cells=plan.reused_cells,
            start_x_m=float(start_m[0]),
            start_y_m=float(start_m[1]),
            goal_x_m=float(goal_m[0]),
            goal_y_m=float(goal_m[1]),
            goal_projected=goal_projected,
            us=microseconds,
            astar_expanded=optimum.expanded,
            astar_generated=optimum.generated,
        )

    def _shift_to(self, window: Window) -> Cell:
        """How far the window moved since the last plan; another cell size shares nothing, so the planner forgets."""
        if self._last_window is None:
            return 0, 0
        if self._last_window.cell_m != window.cell_m:
            self._planner.reset()
            return 0, 0
        return self._last_window.shift_to(window)

    def _path(self, t_ns: int, raw_m: Float, query: Query, window: Window) -> PlannedPath:
        settings = self._settings
        if settings.smooth:
            blocked = query.blocked
            if len(query.way_out):
                blocked = blocked.copy()
                blocked[query.way_out[:, 1], query.way_out[:, 0]] = False
            smooth_m = smooth_path(raw_m, settings.merge_m, settings.spacing_m, blocked, window.origin_m, window.cell_m)
        else:
            smooth_m = straight_path(raw_m, settings.spacing_m)
        return PlannedPath(t_ns, resample(raw_m, len(smooth_m)), smooth_m)


def _walkable(plan: Plan, query: Query, window: Window, start_xy_m: Float, goal_xy_m: Float) -> Float:
    """The path (L, 2) in map from where the robot really is over the cells' centres to the goal point."""
    points_m = window.centre_of(np.concatenate([query.way_out, plan.cells]))
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
