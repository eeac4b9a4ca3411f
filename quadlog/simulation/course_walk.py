"""A walk along a course: pure pursuit steers, the robot walks, and every tick of control is written down."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.following.lookahead import LookaheadControl
from quadlog.messages import Float
from quadlog.metrics.effort import Effort
from quadlog.simulation.course_robot import CourseRobot
from quadlog.simulation.courses import Course
from quadlog.simulation.pursuit_ticks import COMMAND, TICK_COLUMNS, FollowedPath, follow_tick

NS = 1_000_000_000
# A robot that takes so many times as long as the course at its speed, and this longer, arrives no more.
MOST_TIMES, SPARE_S = 2.0, 10.0


@dataclass(frozen=True, slots=True)
class CourseWalk:
    """control: the columns of control.parquet, (T,) each; completed_ns: when it arrived, None when it never did.

    effort: None, and mass_kg NaN, for a robot without a body.
    """

    control: dict[str, NDArray[Any]]
    completed_ns: int | None
    effort: Effort | None
    mass_kg: float


def walk_course(
    course: Course,
    robot: CourseRobot,
    lookahead: LookaheadControl,
    max_yaw_rate_radps: float,
    rate_hz: float,
    most_s: float | None = None,
    watch: Callable[[], None] | None = None,
) -> CourseWalk:
    """Walk the course until its end, a fall, or until it takes too long.

    rate_hz: of control, a divisor of the simulation's rate. Errors are those of the true pose, whatever the robot
    knows of it. most_s: stop after so long, None for what the course should take at most. watch: called at every tick
    of control, before the robot is told what to do.
    """
    path = FollowedPath(course.path_m, course.speed_mps, max_yaw_rate_radps)
    every = max(round(1 / (rate_hz * robot.tick_s)), 1)
    if most_s is None:
        most_s = longest_s(course)
    rows: list[Float] = []
    times_ns: list[int] = []
    completed_ns = None
    while True:
        times_ns.append(round(robot.t_s * NS))
        row = np.full(len(TICK_COLUMNS), np.nan)
        place = follow_tick(row, robot, path, lookahead, robot.t_s, every * robot.tick_s)
        rows.append(row)
        if watch is not None:
            watch()
        arrived = place is not None and place.finished
        if arrived and not robot.fallen:
            completed_ns = times_ns[-1]
        if arrived or robot.fallen or robot.t_s >= most_s:
            break
        robot.walk(every, row[COMMAND], row[COMMAND + 1])
    columns: dict[str, NDArray[Any]] = {"t_ns": np.array(times_ns, dtype=np.int64)}
    columns |= dict(zip(TICK_COLUMNS, np.array(rows).T, strict=True))
    columns["fallen"] = columns["fallen"] > 0
    return CourseWalk(columns, completed_ns, robot.effort, robot.mass_kg)


def longest_s(course: Course) -> float:
    """How long a walk along a course may take."""
    length_m = float(np.hypot(*np.diff(course.path_m, axis=0).T).sum())
    return MOST_TIMES * length_m / course.speed_mps + SPARE_S
