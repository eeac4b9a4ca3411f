"""A walk along a course: pure pursuit steers, the robot walks, and every tick of control is written down."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from quadlog.following.lookahead import LookaheadControl
from quadlog.following.path_follower import PathFollower
from quadlog.messages import Float
from quadlog.metrics.effort import Effort
from quadlog.simulation.courses import Course
from quadlog.simulation.disturbances import Disturbances

NS = 1_000_000_000
# A robot that takes so many times as long as the course at its speed, and this longer, arrives no more.
MOST_TIMES, SPARE_S = 2.0, 10.0

COLUMNS = (
    *("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad", "vx_mps", "vy_mps", "yaw_rate_radps"),
    *("ref_x_m", "ref_y_m", "error_m", "cross_track_m", "time_error_m", "heading_error_rad"),
    *("lookahead_m", "k_v", "k_w", "cmd_v_mps", "cmd_yaw_rate_radps"),
    *(f"tau_{joint:02d}_nm" for joint in range(12)),
    *(f"fz_{leg}_n" for leg in range(4)),
)


class CourseRobot(Protocol):
    """A robot that can be sent along a course; see WalkingRobot and UnicycleRobot."""

    @property
    def tick_s(self) -> float: ...
    @property
    def t_s(self) -> float: ...
    @property
    def fallen(self) -> bool: ...
    @property
    def disturbances(self) -> Disturbances: ...
    @property
    def effort(self) -> Effort | None: ...
    @property
    def mass_kg(self) -> float: ...
    @property
    def pose(self) -> Float: ...
    @property
    def position_m(self) -> Float: ...
    @property
    def rpy(self) -> tuple[float, float, float]: ...
    @property
    def velocity(self) -> tuple[float, float, float]: ...
    @property
    def torques_nm(self) -> Float: ...
    @property
    def foot_loads_n(self) -> Float: ...
    def walk(self, ticks: int, speed_mps: float, yaw_rate_radps: float) -> None: ...


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
    follower, truth = PathFollower(course.path_m), PathFollower(course.path_m)
    every = max(round(1 / (rate_hz * robot.tick_s)), 1)
    dt_s = every * robot.tick_s
    if most_s is None:
        most_s = longest_s(course)
    rows: list[tuple[float, ...]] = []
    times_ns: list[int] = []
    fallen: list[bool] = []
    completed_ns = None
    while True:
        pose = robot.pose
        place = truth.step(*pose.tolist())
        times_ns.append(round(robot.t_s * NS))
        x_m, y_m, yaw_rad = robot.disturbances.measured(robot.t_s, pose).tolist()
        known = follower.step(x_m, y_m, yaw_rad)
        ahead = lookahead.step(known.near.distance_m, dt_s, robot.velocity[0])
        command = follower.pursue(x_m, y_m, yaw_rad, known, ahead.l_m, course.speed_mps, max_yaw_rate_radps)
        reference = truth.reference_at(course.speed_mps * robot.t_s)
        rows.append(
            (
                *(*robot.position_m.tolist(), *robot.rpy),
                *robot.velocity,
                *(place.near.x_m, place.near.y_m, place.error_m, place.near.distance_m),
                math.hypot(reference.x_m - pose[0], reference.y_m - pose[1]),
                place.heading_error_rad,
                *(ahead.l_m, ahead.k_v, ahead.k_w, command.v_mps, command.yaw_rate_radps),
                *robot.torques_nm.tolist(),
                *robot.foot_loads_n.tolist(),
            )
        )
        fallen.append(robot.fallen)
        if watch is not None:
            watch()
        if place.finished and not robot.fallen:
            completed_ns = times_ns[-1]
        if place.finished or robot.fallen or robot.t_s >= most_s:
            break
        robot.walk(every, command.v_mps, command.yaw_rate_radps)
    columns: dict[str, NDArray[Any]] = {"t_ns": np.array(times_ns, dtype=np.int64)}
    columns |= dict(zip(COLUMNS, np.array(rows).T, strict=True))
    columns["fallen"] = np.array(fallen)
    return CourseWalk(columns, completed_ns, robot.effort, robot.mass_kg)


def longest_s(course: Course) -> float:
    """How long a walk along a course may take."""
    length_m = float(np.hypot(*np.diff(course.path_m, axis=0).T).sum())
    return MOST_TIMES * length_m / course.speed_mps + SPARE_S
