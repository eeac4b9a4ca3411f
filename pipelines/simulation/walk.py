"""One simulated walk, along a course or a trot, from the configuration and a seed."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from quadlog.config.control import Simulation
from quadlog.config.schema import Config
from quadlog.control.following.lookahead import FixedLookahead, FuzzyLookahead, FuzzySettings, LookaheadControl
from quadlog.control.locomotion.foot_trajectory import EASED, PARABOLA, lateral_peak_m
from quadlog.control.locomotion.mpc import MpcSettings
from quadlog.control.locomotion.plugged import plugged_controller
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.control.locomotion.walker import WalkerSettings
from quadlog.errors import InvalidConfigValue, UnknownName
from quadlog.messages import GRAVITY_MPS2, NS_PER_S, Float
from quadlog.metrics.summary import Metric, Metrics
from quadlog.metrics.walking import drift_metrics
from quadlog.simulation.course_walk import Course, CourseWalk, walk_course
from quadlog.simulation.robot import trot as trotting
from quadlog.simulation.robot.disturbances import DisturbanceSettings
from quadlog.simulation.robot.height_field import HeightField
from quadlog.simulation.robot.model import TIMESTEP_S, QuadrupedModel, quadruped_model
from quadlog.simulation.robot.unicycle_robot import UnicycleRobot
from quadlog.simulation.robot.user_model import load_user_model
from quadlog.simulation.robot.walking_robot import WalkingRobot

MODEL_FILES = (".xml", ".mjcf", ".urdf")


def robot_model(config: Config, ground: HeightField) -> QuadrupedModel:
    """The robot of [robot] model on its ground. Raises UnknownName, and what loading a user's file raises."""
    name, friction = config.robot.model, config.simulation.friction
    if name in ROBOTS:
        return quadruped_model(ROBOTS[name], ground, friction)
    if Path(name).suffix.lower() not in MODEL_FILES:
        raise UnknownName("robot", name, [*ROBOTS, f"a file ({', '.join(MODEL_FILES)})"])
    return load_user_model(Path(name), ground, friction)


def walker_settings(config: Config) -> WalkerSettings:
    """Gait, MPC and whole-body control, or a plug-in. Raises QuadlogError for one that cannot be used."""
    simulation = config.simulation
    return WalkerSettings(
        gait=simulation.gait,
        clearance_m=simulation.clearance_m,
        whole_body=simulation.parts is None or simulation.parts.whole_body,
        mpc_every_s=config.mpc.every_s,
        turning_share=config.mpc.turning_share,
        mpc=MpcSettings(**config.mpc.model_dump(exclude={"every_s", "turning_share"})),
        controller=plugged_controller(simulation.controller),
    )


def lookahead_control(config: Config) -> LookaheadControl:
    """The controller's. A new one for every walk: it remembers its last error."""
    parts, l0_m = config.simulation.parts, config.pursuit.lookahead_m
    if parts is None or not parts.fuzzy:
        return FixedLookahead(l0_m)
    fuzzy = config.pursuit.fuzzy.model_dump()
    lambdas = {"lambda_v": fuzzy.pop("lambda_v_s2_per_m"), "lambda_w": fuzzy.pop("lambda_w_s")}
    return FuzzyLookahead(FuzzySettings(l0_m=l0_m, **lambdas, **fuzzy))


def check_rate(rate_hz: float) -> None:
    """Control ticks with the simulation: every whole number of its steps. Raises InvalidConfigValue."""
    steps = 1 / (rate_hz * TIMESTEP_S)
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-6 * steps:
        own_hz = round(1 / TIMESTEP_S)
        reason = f"must divide the simulation's {own_hz} Hz, as 50, 100 or {own_hz} do (got {rate_hz:g})"
        raise InvalidConfigValue("pursuit.rate_hz", reason, "simulate")


# Beside the seed itself, which draws the ground.
_DISTURBS = 1


@dataclass(frozen=True, slots=True)
class SimulatedWalk:
    """counts: see Walker.counts. seconds: spent walking."""

    walk: CourseWalk
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
    disturbances = DisturbanceSettings(**config.simulation.disturbances.model_dump())
    pursuit = config.pursuit
    robot: WalkingRobot | UnicycleRobot
    if not config.simulation.has_body:
        robot = UnicycleRobot(course.start_pose, TIMESTEP_S, rng, disturbances)
    else:
        robot = WalkingRobot(robot_model(config, ground), walker_settings(config), course.start_pose, rng, disturbances)
    started = time.perf_counter()
    walk = walk_course(course, robot, lookahead_control(config), pursuit.max_yaw_rate_radps, pursuit.rate_hz, most_s)
    seconds = time.perf_counter() - started
    return SimulatedWalk(walk, robot.counts if isinstance(robot, WalkingRobot) else {}, seconds)


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


CURVES = ("baseline", "3d-curve")
"""Swings without and with y(t): experiments one and two of the paper."""
SHAPES = {"parabola": PARABOLA, "eased": EASED}
FIRST_PAIRS = ("left_fore", "right_fore")


@dataclass(frozen=True, slots=True, eq=False)
class PlannedTrot:
    """The robot as it is, what its joints are sent to (N, 12) and how far they start beside, and the peak of y(t)."""

    robot: trotting.TrotRobot
    targets_rad: Float
    posture_rad: Float
    peak_m: float


@dataclass(frozen=True, slots=True, eq=False)
class TrottedCurve:
    """A walk, what was planned, and the seconds that simulating took."""

    walk: trotting.TrotWalk
    planned: PlannedTrot
    seconds: float


def trot_once(simulation: Simulation, curve: str, seed: int) -> TrottedCurve:
    """One walk with one of CURVES. Raises as plan_trot does."""
    planned = plan_trot(simulation, curve, seed)
    model = trotting.trot_model(planned.robot)
    started = time.perf_counter()
    walk = trotting.walk_trot(model, planned.targets_rad, planned.posture_rad)
    return TrottedCurve(walk, planned, time.perf_counter() - started)


def plan_trot(simulation: Simulation, curve: str, seed: int) -> PlannedTrot:
    """What a seed draws, and the curve for it. Raises InvalidConfigValue for one that is out of the legs' reach."""
    trot = simulation.trot
    draw = trotting.draw_trot(
        seed, trot.friction_spread, trot.foot_radius_spread, math.radians(trot.posture_spread_deg)
    )
    plan = trotting.TrotRobot(height_m=trot.height_m)
    robot = replace(
        plan,
        friction=simulation.friction * (1 + draw.friction_share),
        foot_radius_m=plan.foot_radius_m * (1 + draw.radius_share),
        payload_kg=trot.payload_kg,
        payload_x_m=trot.payload_x_m,
        payload_y_m=trot.payload_y_m,
        leg_mass_spread=trot.leg_mass_spread,
        hip_offset_m=trot.hip_offset_m,
    )
    peak_m = 0.0
    if curve == "3d-curve":  # of right fore and left hind leg, by the planned robot, which does not know its payload
        model, k = trotting.trot_model(plan), trot.foot_curve_k
        inertia_kgm2 = trotting.hip_inertia_kgm2(model)
        peak_m = lateral_peak_m(trotting.gravity_moment_nm(model), k, inertia_kgm2, trotting.PERIOD_S)
    first = FIRST_PAIRS.index(trot.first_pair)
    try:
        asides_m = np.where((trotting.PAIRS == 1) | (trot.lateral == "same"), peak_m, -peak_m)
        targets = trotting.joint_targets(plan.plan, asides_m, SHAPES[trot.lateral_shape], first)
    except trotting.OutOfReach as error:
        raise InvalidConfigValue("simulation.trot.foot_curve_k", str(error), "simulate trot-32s") from None
    return PlannedTrot(robot, targets, draw.of_pair(first), peak_m)


def trot_metrics(trotted: TrottedCurve) -> Metrics:
    """Drift, ranges and a fall; and how fast it was simulated."""
    walk = trotted.walk
    rest, period = (round(seconds * trotting.SAMPLES_HZ) for seconds in (trotting.REST_S, trotting.PERIOD_S))
    metrics = drift_metrics(walk.position_m, walk.rpy_rad, walk.fallen, rest, period, trotting.PERIOD_S)
    metrics["torque_max_nm"] = Metric(float(np.abs(walk.torques_nm).max()), walk.torques_nm.size, "N·m")
    metrics["realtime_factor"] = Metric(float(walk.t_ns[-1]) * 1e-9 / trotted.seconds, 1, "")
    return metrics
