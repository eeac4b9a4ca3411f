"""One simulated walk: a robot, its controller and what disturbs it, along a course on its ground."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from quadlog.config import Config
from quadlog.messages import Float
from quadlog.pipelines.simulation.settings import (
    disturbance_settings,
    lookahead_control,
    robot_model,
    walker_settings,
)
from quadlog.pipelines.stages.first_compilation import SAID, on_first_compilation
from quadlog.simulation.course_walk import CourseWalk, walk_course
from quadlog.simulation.courses import Course
from quadlog.simulation.ground import Ground
from quadlog.simulation.quadruped_model import TIMESTEP_S, QuadrupedModel
from quadlog.simulation.unicycle_robot import UnicycleRobot
from quadlog.simulation.walking_robot import WalkingRobot

# Beside the seed itself, which draws the ground.
_DISTURBS = 1
_CARRYING_ON = ("shifted", "shared", "projected")
"""What MPC and whole-body control do when their solvers fail."""


@dataclass(frozen=True, slots=True)
class SimulatedWalk:
    """joints: (T, nq) MuJoCo's coordinates at each tick of control, None without a body, as model is.

    counts: how often each solver ended how; seconds: spent walking, the robot's making left out.
    """

    walk: CourseWalk
    model: QuadrupedModel | None
    joints: Float | None
    counts: dict[str, int]
    seconds: float

    @property
    def failed_solves(self) -> int:
        """How often older or simpler forces had to do."""
        return sum(count for name, count in self.counts.items() if name.endswith(_CARRYING_ON))


def walk_once(course: Course, config: Config, ground: Ground, seed: int, most_s: float | None = None) -> SimulatedWalk:
    """Walk the course; the seed draws what disturbs. Raises what a user's robot model raises."""
    rng = np.random.default_rng([seed, _DISTURBS])
    disturbances = disturbance_settings(config.simulation.disturbances)
    pursuit = config.pursuit
    snapshots: list[Float] = []
    watch: Callable[[], None] | None = None
    robot: WalkingRobot | UnicycleRobot
    model = None
    if config.simulation.controller == "kinematic":
        robot = UnicycleRobot(course.start_pose, TIMESTEP_S, rng, disturbances)
    else:
        model = robot_model(config, ground)
        robot = WalkingRobot(model, walker_settings(config, model.robot), course.start_pose, rng, disturbances)
        walking = robot
        if config.results.frames:
            watch = lambda: snapshots.append(walking.joints)  # noqa: E731 (a name for it would say no more)
    started = time.perf_counter()
    walk = walk_course(
        course, robot, lookahead_control(config), pursuit.max_yaw_rate_radps, pursuit.rate_hz, most_s, watch
    )
    seconds = time.perf_counter() - started
    joints = np.array(snapshots) if snapshots else None
    return SimulatedWalk(walk, model, joints, solver_counts(robot), seconds)


def solver_counts(robot: WalkingRobot | UnicycleRobot) -> dict[str, int]:
    """How often each solver of a robot ended how; nothing without a body."""
    if isinstance(robot, UnicycleRobot):
        return {}
    walker = robot.walker
    counts: dict[str, int] = {}
    solvers: dict[str, Counter] = {"mpc": walker.mpc.counts, "wbc": walker.wbc.counts}
    for solver, statuses in solvers.items():
        counts |= {f"{solver}_{status.replace(' ', '_')}": count for status, count in sorted(statuses.items())}
    if walker.wbc.damped:
        counts["wbc_damped"] = walker.wbc.damped
    return counts


def warm_up(course: Course, config: Config, ground: Ground, say: Callable[[str], None]) -> float:
    """Load and compile what a walk needs by a tenth of a second of it; returns the seconds it took.

    say: told in one line when there is anything to compile.
    """
    started = time.perf_counter()
    with on_first_compilation(lambda: say(SAID)):
        walk_once(course, config, ground, 0, most_s=0.1)
    return time.perf_counter() - started
