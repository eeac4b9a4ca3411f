"""The walk again, closed loop: a simulated robot among the recorded maps, towards the recorded target.

At every recorded map a plan starts where the simulated robot is; between maps
it follows that plan by pure pursuit, with or without a body. Where there is no
new plan, because the robot left the recorded window or is walled in, it holds
its last one; a robot that has fallen lies.

Its errors are those beside a plan that is held for as long as it takes to walk
it, whatever is planned meanwhile; the next one is the first plan after that. They
also set the fuzzy look-ahead. The plan that is followed is no reference: each
starts at the robot, so that the distance to it says no more than how old it is, a
tenth of a second. Nor is the logged path: which way that robot took says nothing of
how this one walks its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np

from quadlog.control.following.path import FreeSpace
from quadlog.control.following.pure_pursuit import Command, FollowState
from quadlog.errors import TooLarge
from quadlog.mapping.grid import Window
from quadlog.messages import NS_PER_S, Float, Int
from quadlog.planning.protocol import Bool
from quadlog.planning.query import passable
from quadlog.planning.replan import PlannedPath, Replanner, Row
from quadlog.simulation.contacts import (
    Contact,
    ContactLog,
    Footprint,
    PlanInUse,
    TouchableCells,
    cause_of,
    nearest_cell,
)
from quadlog.simulation.course_walk import (
    COMMAND,
    PLAN_ERROR,
    TICK_COLUMNS,
    Driver,
    FollowedPath,
    write_errors,
)
from quadlog.simulation.settings import RATE_HZ
from quadlog.simulation.worlds.world import body_clearance, body_gaps

# A day at 50 Hz; a clock that jumps must not become an allocation.
MAX_TICKS = 5_000_000
# The column after those of TICK_COLUMNS: clearance to obstacles.
CLEARANCE = len(TICK_COLUMNS)


@dataclass(frozen=True, slots=True)
class MapInstant:
    """One recorded map: occupied (rows, cols) bool of a window, undilated, at t_ns.

    standing: cells that the map of the whole run holds occupied. The robot plans on `occupied`; clearance is to
    both. start_pose: (3,) where the walk starts again with this map, after a gap that nothing walks in.
    """

    t_ns: int
    window: Window
    occupied: Bool
    standing: Bool | None = None
    start_pose: Float | None = None


class HeldPlan(NamedTuple):
    """A plan taken as the reference from since_ns on, for as long as walking it at speed_mps takes."""

    path: FollowedPath
    since_ns: int
    speed_mps: float

    def place_at(self, t_ns: int) -> tuple[float, float]:
        """(x_m, y_m) where a robot without delay would be; its end when that time is over."""
        return self.path.known.reference_at((t_ns - self.since_ns) / NS_PER_S * self.speed_mps)


@dataclass(frozen=True, slots=True)
class Resimulation:
    """A re-simulated walk of T ticks.

    control: the columns of control.parquet, (T,) each. What a robot without a body does not have is NaN; so are
    k_v and k_w where the look-ahead is fixed, and the errors and the reference before there is a plan.
    clearance_m: (T,) see body_clearance; NaN outside the recorded window. target_distance_m: (T,).
    contacts: in the order in which they began.
    plans, paths: of the simulated robot, one record for each map that it was inside of.
    outside_ticks: ticks outside the window recorded last; outside_replans: maps that could not be planned on.
    """

    control: dict[str, Float | Int | Bool]
    clearance_m: Float
    target_distance_m: Float
    contacts: list[Contact]
    plans: list[Row]
    paths: list[PlannedPath]
    outside_ticks: int
    outside_replans: int


@dataclass(slots=True)
class _State:
    """What is carried from one map to the next."""

    driver: Driver
    cells: TouchableCells
    contacts: ContactLog = field(default_factory=ContactLog)
    held: HeldPlan | None = None
    command: Command | None = None
    plan: FollowedPath | None = None
    planned_at_ns: int = 0
    plans: list[Row] = field(default_factory=list)
    paths: list[PlannedPath] = field(default_factory=list)
    outside_ticks: int = 0
    outside_replans: int = 0

    def restart(self, pose: Float, ended_ns: int) -> None:
        """The robot stands at a pose (3,), without a plan or a contact; it walked until ended_ns."""
        self.contacts.end(ended_ns)
        self.driver.robot.start_at(pose)
        self.driver.lookahead.reset()
        self.cells = TouchableCells(self.cells.body)
        self.held, self.command, self.plan = None, None, None


def resimulate(
    instants: Iterable[MapInstant],
    target_xy_at: Callable[[Int], Float],
    driver: Driver,
    replanner: Replanner,
    body: Footprint,
    clear_chord: bool = True,
) -> Resimulation:
    """Walks from where the robot is, at the first map's instant, until the last one's, without the gaps.

    instants: in time order; only two are held at a time.
    target_xy_at: from t_ns (N,) to (N, 2) in map, NaN where there is none.
    replanner: plans between the maps; see Replanner for stopping short. clear_chord: the look-ahead ends where the
    straight line to it leaves the space that the plan could use.
    Raises TooLarge when the maps span more than MAX_TICKS ticks, ValueError when they are not in order.
    """
    walk = _State(driver, TouchableCells(body))
    ticks_ns: list[Int] = [np.empty(0, dtype=np.int64)]
    rows: list[Float] = [np.empty((0, len(TICK_COLUMNS) + 1))]
    first_ns, tick, ticks = None, 0, 0
    for instant, next_ns in _with_next(instants):
        if instant.start_pose is not None:
            walk.restart(instant.start_pose, int(ticks_ns[-1][-1]) if ticks_ns[-1].size else instant.t_ns)
            replanner.restart()
            first_ns, tick, ticks = None, 0, ticks + tick
        first_ns = instant.t_ns if first_ns is None else first_ns
        _replan(walk, replanner, instant, target_xy_at(np.array([instant.t_ns]))[0], clear_chord)
        # Ticks up to the next map's instant, which itself belongs to that map's plan.
        until = max(math.ceil((next_ns - first_ns) * RATE_HZ / NS_PER_S), 0)
        if ticks + until > MAX_TICKS:
            raise TooLarge("ticks of the re-simulated walk", ticks + until, MAX_TICKS)
        t_ns = first_ns + np.rint(np.arange(tick, until) * (NS_PER_S / RATE_HZ)).astype(np.int64)
        tick = until
        ticks_ns.append(t_ns)
        rows.append(_follow(walk, instant, next_ns, t_ns))
    return _gathered(walk, np.concatenate(ticks_ns), np.concatenate(rows), target_xy_at)


def _with_next(instants: Iterable[MapInstant]) -> Iterator[tuple[MapInstant, int]]:
    """Every instant with the time of the one after it; the last before a gap lasts for the tick at its own time."""
    last = None
    for instant, following in pairwise(chain(instants, [None])):
        if instant is None:
            break
        if last is not None and instant.t_ns < last:
            raise ValueError(f"maps are not in time order: {instant.t_ns} after {last}")
        last = instant.t_ns
        next_ns = instant.t_ns + 1 if following is None or following.start_pose is not None else following.t_ns
        yield instant, next_ns


def _replan(walk: _State, replanner: Replanner, instant: MapInstant, target_m: Float, clear_chord: bool) -> None:
    here = walk.driver.robot.pose[:2]
    if not np.isfinite(target_m).all():
        return
    if not instant.window.contains(instant.window.cell_of(here)):
        walk.outside_replans += 1
        return
    replan = replanner.replan(instant.t_ns, instant.window, instant.occupied, here.copy(), target_m)
    walk.plans.append(replan.row)
    if replan.path is not None:
        walk.paths.append(replan.path)
        space = None
        if clear_chord and replan.query is not None:
            blocked = passable(replan.query, instant.occupied, replanner.growth.shape)
            origin_x_m, origin_y_m = instant.window.origin_m.tolist()
            space = FreeSpace(blocked, (origin_x_m, origin_y_m), instant.window.cell_m)
        walk.plan = FollowedPath(replan.path.smooth_xy_m, space)
        walk.planned_at_ns = instant.t_ns
        held, speed_mps = walk.held, walk.driver.speed_mps
        if held is None or instant.t_ns >= held.since_ns + round(held.path.known.length_m / speed_mps * NS_PER_S):
            walk.held = HeldPlan(walk.plan, instant.t_ns, speed_mps)
            walk.driver.lookahead.reset()


def _follow(walk: _State, instant: MapInstant, next_ns: int, t_ns: Int) -> Float:
    """Lets the robot follow its plan over the ticks t_ns (N,): rows (N, len(TICK_COLUMNS) + 1)."""
    driver, robot, rows = walk.driver, walk.driver.robot, np.full((len(t_ns), len(TICK_COLUMNS) + 1), np.nan)
    body, centres_m = walk.cells.body, _touchable(walk, instant, next_ns)
    for row, now_ns in zip(rows, t_ns.tolist(), strict=True):
        pose = robot.pose
        if instant.window.contains(instant.window.cell_of(pose[:2])):
            around = body.length_m, body.width_m, centres_m, instant.window.cell_m
            row[CLEARANCE] = body_clearance(*pose.tolist(), *around)
        else:
            walk.outside_ticks += 1
        command, on_plan, on_held = driver.steer(row, walk.plan, None if walk.held is None else walk.held.path)
        walk.contacts.tick(now_ns, row[CLEARANCE], partial(_where_and_why, walk, instant, body, centres_m, on_plan))
        walk.command = command
        if on_plan is not None and on_held is not None and walk.held is not None:
            row[PLAN_ERROR] = on_plan.error_m
            write_errors(row, on_held, math.dist(walk.held.place_at(now_ns), pose[:2]))
        robot.walk(driver.every, row[COMMAND], row[COMMAND + 1])
    return rows


def _touchable(walk: _State, instant: MapInstant, next_ns: int) -> Float:
    """The centres (N, 2) of the cells that the body can touch on a map; those that appear inside of it are listed."""
    body, pose = walk.cells.body, walk.driver.robot.pose
    solid = instant.occupied if instant.standing is None else instant.occupied | instant.standing
    centres_m, appeared_m = walk.cells.renew(instant.window, solid, pose)
    if len(appeared_m):
        cell_m = instant.window.cell_m
        nearest_m = nearest_cell(pose, body, appeared_m, cell_m)
        clearance_m = body_gaps(pose, body.length_m, body.width_m, nearest_m[None], cell_m)
        walk.contacts.appeared(instant.t_ns, next_ns, nearest_m, float(clearance_m[0]))
    return centres_m


def _where_and_why(
    walk: _State, instant: MapInstant, body: Footprint, centres_m: Float, on_plan: FollowState | None
) -> tuple[Float, str]:
    cell_m = nearest_cell(walk.driver.robot.pose, body, centres_m, instant.window.cell_m)
    col, row = instant.window.cell_of(cell_m)
    plan = None
    if walk.plan is not None and on_plan is not None:
        here_m = walk.driver.robot.pose[:2]
        aim_m = here_m if walk.command is None else np.array(walk.command[2:])
        is_newest, chord_m = walk.planned_at_ns == instant.t_ns, np.stack([here_m, aim_m])
        plan = PlanInUse(walk.plan.known.path, is_newest, on_plan.remaining_m, chord_m)
    return cell_m, cause_of(cell_m, bool(instant.occupied[row, col]), walk.driver.robot.fallen, plan, body.width_m)


def _gathered(walk: _State, t_ns: Int, rows: Float, target_xy_at: Callable[[Int], Float]) -> Resimulation:
    ticks, clearance_m = dict(zip(TICK_COLUMNS, rows.T[:CLEARANCE], strict=True)), rows[:, CLEARANCE]
    control: dict[str, Float | Int | Bool] = {"t_ns": t_ns, **ticks, "fallen": ticks["fallen"] > 0}
    target_m = target_xy_at(t_ns)
    target_distance_m = np.hypot(target_m[:, 0] - ticks["x_m"], target_m[:, 1] - ticks["y_m"])
    if len(t_ns):
        walk.contacts.end(int(t_ns[-1]))
    return Resimulation(
        control, clearance_m, target_distance_m, walk.contacts.contacts, walk.plans, walk.paths, walk.outside_ticks,
        walk.outside_replans,
    )  # fmt: skip
