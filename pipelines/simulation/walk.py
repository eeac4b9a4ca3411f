"""One simulated walk along a course, from the configuration and a seed."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quadlog.config.controllers import controller_plugin
from quadlog.config.schema import Config
from quadlog.control.following.lookahead import FixedLookahead, FuzzyLookahead, LookaheadControl
from quadlog.control.locomotion.plugged import plugged_controller
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.control.locomotion.walker import WalkerSettings
from quadlog.errors import UnknownName
from quadlog.messages import GRAVITY_MPS2, NS_PER_S
from quadlog.simulation.course_walk import Course, CourseWalk, walk_course
from quadlog.simulation.robot.height_field import HeightField
from quadlog.simulation.robot.model import QuadrupedModel, quadruped_model
from quadlog.simulation.robot.unicycle_robot import UnicycleRobot
from quadlog.simulation.robot.user_model import load_user_model
from quadlog.simulation.robot.walking_robot import WalkingRobot

MODEL_FILES = (".xml", ".mjcf", ".urdf")


def robot_model(config: Config, ground: HeightField) -> QuadrupedModel:
    """The robot of [robot] model on its ground. Raises UnknownName, and what loading a user's file raises."""
    name, friction = config.robot.model, config.simulation.friction
    if name not in ROBOTS and Path(name).suffix.lower() not in MODEL_FILES:
        raise UnknownName("robot", name, [*ROBOTS, f"a file ({', '.join(MODEL_FILES)})"])
    known = ROBOTS.get(name)
    robot = quadruped_model(known, ground, friction) if known else load_user_model(Path(name), ground, friction)
    robot.model.opt.timestep = config.simulation.step_s
    return robot


def walker_settings(config: Config) -> WalkerSettings:
    """Gait, MPC and whole-body control, or a plug-in. Raises QuadlogError for one that cannot be used."""
    simulation = config.simulation
    return WalkerSettings(
        gait=simulation.gait,
        clearance_m=simulation.clearance_m,
        whole_body=simulation.parts is None or simulation.parts.whole_body,
        mpc=config.mpc,
        controller=plugged_controller(controller_plugin(simulation.controller)),
    )


def lookahead_control(config: Config) -> LookaheadControl:
    """The controller's. A new one for every walk: it remembers its last error."""
    parts = config.simulation.parts
    is_fuzzy = parts is not None and parts.fuzzy
    return FuzzyLookahead(config.pursuit) if is_fuzzy else FixedLookahead(config.pursuit.lookahead_m)


# Beside the seed itself, which draws the ground.
_DISTURBS = 1


@dataclass(frozen=True, slots=True)
class SimulatedWalk:
    """ticks: of the simulation. counts: see Walker.counts. seconds: spent walking."""

    walk: CourseWalk
    ticks: int
    counts: dict[str, int]
    seconds: float

    @property
    def lasted_s(self) -> float:
        """Simulated seconds."""
        t_ns = self.walk.control["t_ns"]
        return float(t_ns[-1] - t_ns[0]) / NS_PER_S


def walk_once(
    course: Course, config: Config, ground: HeightField, seed: int, most_s: float | None = None
) -> SimulatedWalk:
    """Walk the course; the seed draws what disturbs. Raises what a user's robot model raises."""
    rng = np.random.default_rng([seed, _DISTURBS])
    disturbances = config.simulation.disturbances
    robot: WalkingRobot | UnicycleRobot
    if not config.simulation.has_body:
        robot = UnicycleRobot(course.start_pose, config.simulation.step_s, rng, disturbances)
    else:
        robot = WalkingRobot(robot_model(config, ground), walker_settings(config), course.start_pose, rng, disturbances)
    started = time.perf_counter()
    walk = walk_course(course, robot, lookahead_control(config), config.pursuit.max_yaw_rate_radps, most_s)
    seconds = time.perf_counter() - started
    return SimulatedWalk(walk, robot.ticks, robot.counts if isinstance(robot, WalkingRobot) else {}, seconds)


def walk_warnings(counts: Mapping[str, int], mass_kg: float, most_n: float | None) -> list[str]:
    """What to look at: counts as Walker has them; mass_kg NaN without a body; most_n as MpcSettings has f_max_n."""
    warnings = []
    if failed := sum(count for name, count in counts.items() if name.endswith("_failed")):
        warnings.append(f"{failed} QPs failed; simpler forces were used: see counts")
    weight_n = mass_kg * GRAVITY_MPS2
    # Two feet carry in a trot, and have to push harder than the weight to go up.
    if most_n is not None and weight_n > 1.5 * most_n:
        warnings.append(f"the robot weighs {weight_n:.0f} N; two feet of mpc.f_max_n = {most_n:g} N may not carry it")
    return warnings
