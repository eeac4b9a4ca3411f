"""One replan, from a map to a path that can be walked: the same for the logged walk and the re-simulated one."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from quadlog.geometry import arc_lengths
from quadlog.mapping.grid import Window
from quadlog.messages import Float
from quadlog.planning.path import largest_curvature, resample, smooth_path, straight_path, turning
from quadlog.planning.planners.astar import AStar
from quadlog.planning.protocol import Bool, Cell, Cells, Plan, Planner, is_usable, no_plan
from quadlog.planning.query import NoQuery, Query, make_query


@dataclass(frozen=True, slots=True)
class ReplanSettings:
    """How a map becomes a path.

    dilation_m: obstacles grow by this; dilation: of `goal_projection.INFLATIONS`.
    stop_short_m: the path ends so far from the goal, 0 to reach it.
    smooth, merge_m, spacing_m: see smooth_path.
    """

    dilation_m: float = 0.3
    dilation: str = "euclidean"
    stop_short_m: float = 1.0
    smooth: bool = True
    merge_m: float = 0.6
    spacing_m: float = 0.05


@dataclass(frozen=True, slots=True)
class Answer:
    """What a planner answered. why_not is empty when it found a path, "missed" when there was one that it did not find.

    optimal_cost: of the cheapest path there is, NaN where there is none. us: microseconds in the planner, the median of
    us_repeats, those of each time it was asked; NaN when it was not. length_m and turn_rad: of the path on the grid,
    turn_rad the sum of its changes of heading.
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
    us_repeats: tuple[float, ...] = ()


class Panel:
    """Asks its planners in turns, so that none is always the one that finds the map in the processor's cache.

    smoothing: how paths are smoothed; None leaves curvatures out.
    doubles: more of the same planners, in the same order, which are asked the same in further rounds for their times
    alone: what an incremental planner remembers from one question to the next is then the same in each round.
    """

    def __init__(
        self, planners: Sequence[Planner], smoothing: ReplanSettings | None, doubles: Sequence[Sequence[Planner]] = ()
    ) -> None:
        self._planners = planners
        self._rounds = (planners, *doubles)
        self._smoothing = smoothing
        self._reference = AStar(planners[0].rules)
        self._last_window: Window | None = None
        self._asked = 0
        for planner in self._everyone():
            compile_planner(planner)

    def begin_episode(self) -> None:
        """What comes next has nothing to do with what was before."""
        self._last_window = None
        for planner in self._everyone():
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
        count = len(self._planners)
        plans: list[list[Plan]] = [[] for _ in range(count)]
        us: list[list[float]] = [[] for _ in range(count)]
        for planners in self._rounds:
            self._asked += 1
            for turn in range(count):
                at = (self._asked + turn) % count
                began_ns = time.perf_counter_ns()
                plans[at].append(planners[at].plan(query.blocked, query.start, query.goal, shift))
                us[at].append((time.perf_counter_ns() - began_ns) / 1000)
        return [self._answer(each.name, query, plans[at][0], us[at], optimum) for at, each in enumerate(self._planners)]

    def _everyone(self) -> Iterator[Planner]:
        return (planner for planners in self._rounds for planner in planners)

    def _answer(self, name: str, query: Query, plan: Plan, us: list[float], optimum: Plan) -> Answer:
        optimal_cost = optimum.cost if optimum.found else math.nan
        median_us, repeats_us = float(np.median(us)), tuple(us)
        if not plan.found:
            why_not = "missed" if optimum.found else why_no_path(query.blocked, query.start, query.goal)
            return Answer(
                name, plan, why_not, optimal_cost, median_us, math.nan, math.nan, math.nan, us_repeats=repeats_us
            )
        length_m, turn_rad = turning(plan.cells * query.window.cell_m)
        curvature = self._curvature(query, plan.cells)
        return Answer(name, plan, "", optimal_cost, median_us, length_m, turn_rad, curvature, repeats_us)

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
    """What one replan gives; path is None when no way was found, query where there was nothing to plan."""

    record: PlanRecord
    path: PlannedPath | None
    query: Query | None


class Replanner:
    """Replans on one map after another, and passes to an incremental planner how the window moved between them."""

    def __init__(self, planner: Planner, settings: ReplanSettings) -> None:
        self._planner = planner
        self.settings = settings
        self._reference = AStar(planner.rules)
        self._last_window: Window | None = None
        compile_planner(planner)

    def restart(self) -> None:
        """What comes next has nothing to do with what was before."""
        self._planner.reset()
        self._last_window = None

    def replan(self, t_ns: int, window: Window, occupied: Bool, start_xy_m: Float, goal_xy_m: Float) -> Replan:
        """From the robot at start_xy_m (2,) towards goal_xy_m (2,), on occupied (rows, cols) of the window, in map.

        See make_query. Raises ValueError for a start that is not finite.
        """
        settings = self.settings
        query = make_query(window, occupied, start_xy_m, goal_xy_m, settings.dilation_m, settings.dilation)
        plan = optimum = no_plan()
        goal_m, goal_projected, microseconds = goal_xy_m, False, math.nan
        path, length_m = None, math.nan
        if not isinstance(query, NoQuery):
            began_ns = time.perf_counter_ns()
            plan = self._planner.plan(query.blocked, query.start, query.goal, self._shift_to(window))
            microseconds = (time.perf_counter_ns() - began_ns) / 1000
            self._last_window = window
            # Not those derived from it, whose heuristic is another.
            is_reference = type(self._planner) is AStar
            optimum = plan if is_reference else self._reference.plan(query.blocked, query.start, query.goal)
            goal_projected = query.goal_projected
            goal_m = window.centre_of(np.array(query.goal)) if goal_projected else goal_xy_m
            if plan.found:
                raw_m = _walkable(plan, query, window, start_xy_m, goal_m)
                raw_m = _stopped_short(raw_m, goal_xy_m, settings.stop_short_m)
                path, length_m = self._path(t_ns, raw_m, query, window), float(arc_lengths(raw_m)[-1])
        record = PlanRecord(
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
            start_x_m=float(start_xy_m[0]),
            start_y_m=float(start_xy_m[1]),
            goal_x_m=float(goal_m[0]),
            goal_y_m=float(goal_m[1]),
            goal_projected=goal_projected,
            us=microseconds,
            astar_expanded=optimum.expanded,
            astar_generated=optimum.generated,
        )
        return Replan(record, path, None if isinstance(query, NoQuery) else query)

    def _shift_to(self, window: Window) -> Cell:
        """How far the window moved since the last plan; another cell size shares nothing, so the planner forgets."""
        if self._last_window is None:
            return 0, 0
        if self._last_window.cell_m != window.cell_m:
            self._planner.reset()
            return 0, 0
        return self._last_window.shift_to(window)

    def _path(self, t_ns: int, raw_m: Float, query: Query, window: Window) -> PlannedPath:
        settings = self.settings
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
