"""The walk again, closed loop: a simulated robot among the recorded maps, towards the recorded target.

At every recorded map a plan starts where the simulated robot is; between maps
it follows that plan by pure pursuit, with or without a body. Where there is no
new plan, because the robot left the recorded window or is walled in, it holds
its last one; a robot that has fallen lies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain, pairwise
from typing import TYPE_CHECKING

import numpy as np

from quadlog.control.following.lookahead import LookaheadControl
from quadlog.errors import TooLarge
from quadlog.geometry import seconds_since
from quadlog.mapping.grid import Window
from quadlog.messages import Float, Int
from quadlog.planning.protocol import Bool
from quadlog.planning.replan import PlannedPath, PlanRecord, Replanner
from quadlog.simulation.course_walk import COMMAND, TICK_COLUMNS, FollowedPath, follow_tick
from quadlog.simulation.worlds.world import body_clearance, occupied_centres

if TYPE_CHECKING:
    from quadlog.simulation.course_walk import CourseRobot

# A day at 50 Hz; a clock that jumps must not become an allocation.
MAX_TICKS = 5_000_000
NS = 1_000_000_000
# The column after those of TICK_COLUMNS: clearance to obstacles.
CLEARANCE = len(TICK_COLUMNS)


@dataclass(frozen=True, slots=True)
class MapInstant:
    """One recorded map: occupied (rows, cols) bool of a window, undilated, at t_ns.

    standing: cells that the map of the whole run holds occupied. The robot plans on `occupied`; clearance is to
    both.
    """

    t_ns: int
    window: Window
    occupied: Bool
    standing: Bool | None = None


@dataclass(frozen=True, slots=True)
class PursuitSettings:
    """How a robot follows its plans, and how large it is."""

    speed_mps: float = 0.6
    max_yaw_rate_radps: float = 1.5
    rate_hz: float = 50.0
    body_length_m: float = 0.62
    body_width_m: float = 0.26


@dataclass(frozen=True, slots=True)
class Resimulation:
    """A re-simulated walk of T ticks.

    control: the columns of control.parquet, (T,) each. What a robot without a body does not have is NaN; so are
    k_v and k_w where the look-ahead is fixed, and the errors and the reference before there is a plan.
    clearance_m: (T,) see body_clearance; NaN outside the recorded window. target_distance_m: (T,).
    plans, paths: of the simulated robot, one record for each map that it was inside of.
    outside_ticks: ticks outside the window recorded last; outside_replans: maps that could not be planned on.
    """

    control: dict[str, Float | Int | Bool]
    clearance_m: Float
    target_distance_m: Float
    plans: list[PlanRecord]
    paths: list[PlannedPath]
    outside_ticks: int
    outside_replans: int


@dataclass(slots=True)
class _State:
    """What is carried from one map to the next."""

    robot: CourseRobot
    lookahead: LookaheadControl
    plan: FollowedPath | None = None
    planned_at_ns: int = 0
    plans: list[PlanRecord] = field(default_factory=list)
    paths: list[PlannedPath] = field(default_factory=list)
    outside_ticks: int = 0
    outside_replans: int = 0


def resimulate(
    instants: Iterable[MapInstant],
    target_xy_at: Callable[[Int], Float],
    robot: CourseRobot,
    lookahead: LookaheadControl,
    replanner: Replanner,
    settings: PursuitSettings,
) -> Resimulation:
    """Walks from where the robot is, at the first map's instant, until the last one's.

    instants: in time order; only two are held at a time.
    target_xy_at: from t_ns (N,) to (N, 2) in map, NaN where there is none.
    replanner: plans between the maps; see ReplanSettings for stopping short.
    Raises TooLarge when the maps span more than MAX_TICKS ticks, ValueError when they are not in order.
    """
    walk = _State(robot, lookahead)
    ticks_ns: list[Int] = [np.empty(0, dtype=np.int64)]
    rows: list[Float] = [np.empty((0, len(TICK_COLUMNS) + 1))]
    first_ns, tick = None, 0
    for instant, next_ns in _with_next(instants):
        first_ns = instant.t_ns if first_ns is None else first_ns
        _replan(walk, replanner, instant, target_xy_at(np.array([instant.t_ns]))[0], settings)
        # Ticks up to the next map's instant, which itself belongs to that map's plan.
        until = max(math.ceil((next_ns - first_ns) * settings.rate_hz / NS), 0)
        if until > MAX_TICKS:
            raise TooLarge("ticks of the re-simulated walk", until, MAX_TICKS)
        t_ns = first_ns + np.rint(np.arange(tick, until) * (NS / settings.rate_hz)).astype(np.int64)
        tick = until
        ticks_ns.append(t_ns)
        rows.append(_follow(walk, instant, t_ns, settings))
    return _gathered(walk, np.concatenate(ticks_ns), np.concatenate(rows), target_xy_at)


def _with_next(instants: Iterable[MapInstant]) -> Iterator[tuple[MapInstant, int]]:
    """Every instant with the time of the one after it; the last lasts for the tick at its own time."""
    last = None
    for instant, following in pairwise(chain(instants, [None])):
        if instant is None:
            break
        if last is not None and instant.t_ns < last:
            raise ValueError(f"maps are not in time order: {instant.t_ns} after {last}")
        last = instant.t_ns
        yield instant, instant.t_ns + 1 if following is None else following.t_ns


def _replan(
    walk: _State, replanner: Replanner, instant: MapInstant, target_m: Float, settings: PursuitSettings
) -> None:
    here = walk.robot.pose[:2]
    if not np.isfinite(target_m).all():
        return
    if not instant.window.contains(instant.window.cell_of(here)):
        walk.outside_replans += 1
        return
    replan = replanner.replan(instant.t_ns, instant.window, instant.occupied, here.copy(), target_m)
    walk.plans.append(replan.record)
    if replan.path is not None:
        walk.paths.append(replan.path)
        walk.plan = FollowedPath(replan.path.smooth_xy_m, settings.speed_mps, settings.max_yaw_rate_radps)
        walk.planned_at_ns = instant.t_ns
        walk.lookahead.reset()


def _follow(walk: _State, instant: MapInstant, t_ns: Int, settings: PursuitSettings) -> Float:
    """Lets the robot follow its plan over the ticks t_ns (N,): rows (N, len(TICK_COLUMNS) + 1)."""
    robot, rows = walk.robot, np.full((len(t_ns), len(TICK_COLUMNS) + 1), np.nan)
    solid = instant.occupied if instant.standing is None else instant.occupied | instant.standing
    centres_m, cell_m = occupied_centres(solid, instant.window), instant.window.cell_m
    since_plan_s = seconds_since(t_ns, walk.planned_at_ns)
    every = max(round(1 / (settings.rate_hz * robot.tick_s)), 1)
    for row, age_s in zip(rows, since_plan_s.tolist(), strict=True):
        x_m, y_m, yaw_rad = robot.pose.tolist()
        if instant.window.contains(instant.window.cell_of(np.array([x_m, y_m]))):
            body = settings.body_length_m, settings.body_width_m
            row[CLEARANCE] = body_clearance(x_m, y_m, yaw_rad, *body, centres_m, cell_m)
        else:
            walk.outside_ticks += 1
        follow_tick(row, robot, walk.plan, walk.lookahead, age_s, every * robot.tick_s)
        robot.walk(every, row[COMMAND], row[COMMAND + 1])
    return rows


def _gathered(walk: _State, t_ns: Int, rows: Float, target_xy_at: Callable[[Int], Float]) -> Resimulation:
    ticks, clearance_m = dict(zip(TICK_COLUMNS, rows.T[:CLEARANCE], strict=True)), rows[:, CLEARANCE]
    control: dict[str, Float | Int | Bool] = {"t_ns": t_ns, **ticks, "fallen": ticks["fallen"] > 0}
    target_m = target_xy_at(t_ns)
    target_distance_m = np.hypot(target_m[:, 0] - ticks["x_m"], target_m[:, 1] - ticks["y_m"])
    return Resimulation(
        control, clearance_m, target_distance_m, walk.plans, walk.paths, walk.outside_ticks, walk.outside_replans
    )
