"""A walk along a course: pure pursuit steers, the robot walks, and every tick of control is written down."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from quadlog.control.following.lookahead import LookaheadControl
from quadlog.control.following.path import FreeSpace
from quadlog.control.following.pure_pursuit import Command, FollowState, PathFollower
from quadlog.messages import NS_PER_S, Float
from quadlog.metrics.walking import Effort
from quadlog.simulation.settings import RATE_HZ

if TYPE_CHECKING:
    from quadlog.simulation.robot.unicycle_robot import UnicycleRobot
    from quadlog.simulation.robot.walking_robot import WalkingRobot

    # A robot that takes a speed and a yaw rate and reports its pose. At run time this would import MuJoCo.
    CourseRobot: TypeAlias = UnicycleRobot | WalkingRobot


SPACING_M = 0.02
SPEED_MPS = 0.6
"""Of the line and the circle [Tracking, section 5], and of every path without a speed of its own."""


@dataclass(frozen=True, slots=True)
class Course:
    """A path (K, 2) in map to be walked from its first point to its last, starting in its direction."""

    name: str
    path_m: Float
    speed_mps: float

    @property
    def start_pose(self) -> Float:
        """(3,) x_m, y_m, yaw_rad of the first point."""
        ahead = self.path_m[np.flatnonzero((self.path_m != self.path_m[0]).any(axis=1))[:1]]
        dx, dy = (ahead[0] - self.path_m[0]).tolist() if len(ahead) else (1.0, 0.0)
        return np.array([*self.path_m[0], math.atan2(dy, dx)])


def line() -> Course:
    """From (0, 0) to (10, 10) at 0.6 m/s [Tracking, section 5.1]."""
    return Course("line", _pieces(0.0, 0.0, math.pi / 4, [(10 * math.sqrt(2), 0.0)]), SPEED_MPS)


def circle() -> Course:
    """Once round, radius 5 m, from (0, 0) along +x and to the left, at 0.6 m/s [Tracking, section 5.1]."""
    return Course("circle", _pieces(0.0, 0.0, 0.0, [(10 * math.pi, 1 / 5)]), SPEED_MPS)


def s_curve() -> Course:
    """6 m straight, a quarter, a half and a quarter of a circle of 3 m, left, right, left, 6 m straight, at 0.5 m/s.

    [Tracking, section 5.2] prints a picture of it; the lengths are ours.
    """
    quarter_m = 1.5 * math.pi
    bends = [(quarter_m, 1 / 3), (2 * quarter_m, -1 / 3), (quarter_m, 1 / 3)]
    return Course("s-curve", _pieces(0.0, 0.0, 0.0, [(6.0, 0.0), *bends, (6.0, 0.0)]), 0.5)


TROT = "trot-32s"
"""The experiment of [Foot, section 4], which `quadlog simulate` accepts as a course; it has no path."""
COURSES: dict[str, Callable[[], Course]] = {"line": line, "circle": circle, "s-curve": s_curve}


def _pieces(x_m: float, y_m: float, heading_rad: float, pieces: list[tuple[float, float]]) -> Float:
    """Points (K, 2) along pieces of a length in metres and a curvature in 1/m each, from a pose on."""
    points = [np.array([[x_m, y_m]])]
    for length_m, curvature_1pm in pieces:
        s_m = np.linspace(0.0, length_m, math.ceil(length_m / SPACING_M) + 1)[1:]
        turned_rad = heading_rad + curvature_1pm * s_m
        if curvature_1pm == 0:
            x, y = x_m + s_m * math.cos(heading_rad), y_m + s_m * math.sin(heading_rad)
        else:
            x = x_m + (np.sin(turned_rad) - math.sin(heading_rad)) / curvature_1pm
            y = y_m - (np.cos(turned_rad) - math.cos(heading_rad)) / curvature_1pm
        points.append(np.column_stack([x, y]))
        x_m, y_m, heading_rad = float(x[-1]), float(y[-1]), float(turned_rad[-1])
    return np.concatenate(points)


TICK_COLUMNS = (
    *("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad", "vx_mps", "vy_mps", "yaw_rate_radps"),
    *("ref_x_m", "ref_y_m", "error_m", "cross_track_m", "time_error_m", "heading_error_rad", "plan_error_m"),
    *("lookahead_m", "k_v", "k_w", "cmd_v_mps", "cmd_yaw_rate_radps"),
    *(f"tau_{joint:02d}_nm" for joint in range(12)),
    *(f"fz_{leg}_n" for leg in range(4)),
    *("fallen", "energy_j"),
    *(f"wanted_fz_{leg}_n" for leg in range(4)),
    *("us_median", "us_max", "cmd_vy_mps"),
)
"""Columns of control.parquet without the times, in this order."""
POSE, VELOCITY, REFERENCE, PLAN_ERROR, LOOKAHEAD, COMMAND, EFFORT, FALLEN, ENERGY, WANTED, LEFT = (
    TICK_COLUMNS.index(name)
    for name in (
        *("x_m", "vx_mps", "ref_x_m", "plan_error_m", "lookahead_m", "cmd_v_mps", "tau_00_nm", "fallen", "energy_j"),
        *("wanted_fz_0_n", "cmd_vy_mps"),
    )
)


class FollowedPath:
    """Progress along a path (K, 2) by the robot's true pose and by its measured one.

    space: where the robot may leave the path to cut across; None for anywhere.
    """

    def __init__(self, path_m: Float, space: FreeSpace | None = None) -> None:
        self.known = PathFollower(path_m, space=space)
        self._truth: PathFollower | None = None

    def places(self, pose: Float, measured: Float) -> tuple[FollowState, FollowState]:
        """By the true pose and by the measured one (3,), which are one object where nothing disturbs."""
        known = self.known.step(*measured.tolist())
        if measured is pose:
            return known, known
        self._truth = PathFollower(self.known.path) if self._truth is None else self._truth
        return self._truth.step(*pose.tolist()), known


class Driver:
    """Steers a robot along paths by pure pursuit, once in a fixed number of ticks of its simulation."""

    def __init__(
        self, robot: CourseRobot, lookahead: LookaheadControl, speed_mps: float, max_yaw_rate_radps: float
    ) -> None:
        self.robot, self.lookahead, self.speed_mps = robot, lookahead, speed_mps
        self._limits = speed_mps, max_yaw_rate_radps
        self.every = max(round(1 / (RATE_HZ * robot.tick_s)), 1)

    def steer(
        self, row: Float, path: FollowedPath | None, reference: FollowedPath | None
    ) -> tuple[Command | None, FollowState | None, FollowState | None]:
        """Writes into a row (len(TICK_COLUMNS),) of NaN how the robot is, and the command until the next call.

        Returns that, None to stand still, and where the robot truly is on its path, and beside its reference.

        The robot is steered by its measured pose along the path; None to stand still. How far it looks ahead depends on
        its error beside the reference, which is what is judged. What is written of it is true.
        """
        robot, pose, velocity, command = self.robot, self.robot.pose, self.robot.velocity, None
        measured = robot.disturbances.measured(robot.t_s, pose)
        x_m, y_m, yaw_rad = measured.tolist()
        row[POSE:VELOCITY] = *robot.position_m.tolist(), *robot.rpy
        row[COMMAND], row[COMMAND + 1], row[FALLEN] = 0.0, 0.0, robot.fallen
        on_path = on_reference = None
        if path is not None and reference is not None:
            on_path, known = path.places(pose, measured)
            on_reference, beside = (on_path, known) if reference is path else reference.places(pose, measured)
            ahead = self.lookahead.step(beside.near.distance_m, self.every * robot.tick_s, velocity[0])
            command = path.known.pursue(x_m, y_m, yaw_rad, known, ahead.l_m, *self._limits)
            row[LOOKAHEAD:COMMAND] = ahead
            row[COMMAND], row[COMMAND + 1] = command.v_mps, command.yaw_rate_radps
        has_body = not math.isnan(robot.mass_kg)
        # A robot without a body has the commanded speed at once.
        row[VELOCITY:REFERENCE] = velocity if has_body else (row[COMMAND], 0.0, row[COMMAND + 1])
        row[EFFORT:FALLEN] = *robot.torques_nm.tolist(), *robot.foot_loads_n.tolist()
        if (effort := robot.effort) is not None:
            row[ENERGY] = effort.energy_j
        row[WANTED:LEFT] = *robot.wanted_loads_n.tolist(), *robot.step_us
        return command, on_path, on_reference


def write_errors(row: Float, place: FollowState, time_error_m: float) -> None:
    """Writes into a row where the robot is beside its reference path, and how far from where that is at the instant."""
    near = place.near
    errors = place.error_m, near.distance_m, time_error_m, place.heading_error_rad
    row[REFERENCE:PLAN_ERROR] = near.x_m, near.y_m, *errors


# Timeout of a walk: MOST_TIMES the course's nominal duration plus SPARE_S.
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
    most_s: float | None = None,
) -> CourseWalk:
    """Walk the course until its end, a fall, or until it takes too long.

    Errors are those of the true pose, whatever the robot knows of it. most_s: stop after so long, None for what the
    course should take at most.
    """
    path = FollowedPath(course.path_m)
    driver = Driver(robot, lookahead, course.speed_mps, max_yaw_rate_radps)
    if most_s is None:
        most_s = longest_s(course)
    rows: list[Float] = []
    times_ns: list[int] = []
    completed_ns = None
    while True:
        times_ns.append(round(robot.t_s * NS_PER_S))
        row = np.full(len(TICK_COLUMNS), np.nan)
        _, _, place = driver.steer(row, path, path)
        assert place is not None
        timed_m = path.known.reference_at(robot.t_s * course.speed_mps)
        write_errors(row, place, math.dist(timed_m, row[POSE : POSE + 2]))
        rows.append(row)
        if place.finished and not robot.fallen:
            completed_ns = times_ns[-1]
        if place.finished or robot.fallen or robot.t_s >= most_s:
            break
        robot.walk(driver.every, row[COMMAND], row[COMMAND + 1])
    columns: dict[str, NDArray[Any]] = {"t_ns": np.array(times_ns, dtype=np.int64)}
    columns |= dict(zip(TICK_COLUMNS, np.array(rows).T, strict=True))
    columns["fallen"] = columns["fallen"] > 0
    return CourseWalk(columns, completed_ns, robot.effort, robot.mass_kg)


def longest_s(course: Course) -> float:
    """How long a walk along a course may take."""
    length_m = float(np.hypot(*np.diff(course.path_m, axis=0).T).sum())
    return MOST_TIMES * length_m / course.speed_mps + SPARE_S
