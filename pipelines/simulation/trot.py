"""One walk of the experiment trot-32s [Foot, section 4], from [simulation.trot] and a seed."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from quadlog.config.control import Simulation
from quadlog.control.locomotion.foot_trajectory import EASED, PARABOLA, lateral_peak_m
from quadlog.errors import InvalidConfigValue
from quadlog.messages import Float
from quadlog.metrics.summary import Metric, Metrics
from quadlog.metrics.walking import TrottedWalk, drift_metrics
from quadlog.simulation.robot.model import QuadrupedModel
from quadlog.simulation.robot.trot import (
    PAIRS,
    PERIOD_S,
    REST_S,
    SAMPLES_HZ,
    OutOfReach,
    TrotRobot,
    TrotWalk,
    draw_trot,
    gravity_moment_nm,
    hip_inertia_kgm2,
    joint_targets,
    trot_model,
    walk_trot,
)

CURVES = ("baseline", "3d-curve")
"""Swings without and with y(t): experiments one and two of the paper."""
SHAPES = {"parabola": PARABOLA, "eased": EASED}
FIRST_PAIRS = ("left_fore", "right_fore")


@dataclass(frozen=True, slots=True, eq=False)
class PlannedTrot:
    """The robot as it is, what its joints are sent to (N, 12) and how far they start beside, and the peak of y(t)."""

    robot: TrotRobot
    targets_rad: Float
    posture_rad: Float
    peak_m: float


@dataclass(frozen=True, slots=True, eq=False)
class TrottedCurve:
    """A walk, what was planned, the model that walked, and the seconds that simulating took."""

    walk: TrotWalk
    planned: PlannedTrot
    model: QuadrupedModel
    seconds: float


def trot_once(simulation: Simulation, curve: str, seed: int) -> TrottedCurve:
    """One walk with one of CURVES. Raises as plan_trot does."""
    planned = plan_trot(simulation, curve, seed)
    model = trot_model(planned.robot)
    started = time.perf_counter()
    walk = walk_trot(model, planned.targets_rad, planned.posture_rad)
    return TrottedCurve(walk, planned, model, time.perf_counter() - started)


def plan_trot(simulation: Simulation, curve: str, seed: int) -> PlannedTrot:
    """What a seed draws, and the curve for it. Raises InvalidConfigValue for one that is out of the legs' reach."""
    trot = simulation.trot
    draw = draw_trot(seed, trot.friction_spread, trot.foot_radius_spread, math.radians(trot.posture_spread_deg))
    plan = TrotRobot(height_m=trot.height_m)
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
    peak_m = planned_peak_m(plan, trot.foot_curve_k) if curve == "3d-curve" else 0.0
    first = FIRST_PAIRS.index(trot.first_pair)
    try:
        targets = joint_targets(plan.plan, _asides_m(peak_m, trot.lateral), SHAPES[trot.lateral_shape], first)
    except OutOfReach as error:
        raise InvalidConfigValue("simulation.trot.foot_curve_k", str(error), "simulate trot-32s") from None
    return PlannedTrot(robot, targets, draw.of_pair(first), peak_m)


def planned_peak_m(plan: TrotRobot, k: float) -> float:
    """The peak of y(t) of right fore and left hind leg by the planned robot, which does not know its payload."""
    model = trot_model(plan)
    return lateral_peak_m(gravity_moment_nm(model), k, hip_inertia_kgm2(model), PERIOD_S)


def _asides_m(peak_m: float, lateral: str) -> Float:
    """(4,) of each leg."""
    return np.where((PAIRS == 1) | (lateral == "same"), peak_m, -peak_m)


def trot_metrics(trotted: TrottedCurve) -> Metrics:
    """Drift, ranges and a fall; and how fast it was simulated."""
    walk = trotted.walk
    kept = TrottedWalk(
        x_m=walk.position_m[:, 0],
        y_m=walk.position_m[:, 1],
        rpy_rad=walk.rpy_rad,
        fallen=walk.fallen,
        rest=round(REST_S * SAMPLES_HZ),
        period=round(PERIOD_S * SAMPLES_HZ),
    )
    metrics = drift_metrics(kept, PERIOD_S)
    metrics["torque_max_nm"] = Metric(float(np.abs(walk.torques_nm).max()), walk.torques_nm.size, "N·m")
    metrics["realtime_factor"] = Metric(float(walk.t_ns[-1]) * 1e-9 / trotted.seconds, 1, "")
    return metrics
