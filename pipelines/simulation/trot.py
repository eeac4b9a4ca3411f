"""trot-32s, the experiment of [Foot, section 4]: a robot that trots by joint targets, and what a seed draws for it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout

from quadlog.control.locomotion.kinematics import joints_for
from quadlog.control.locomotion.robot import JOINTS, LEGS, ROBOTS, SIDES, Robot
from quadlog.errors import InvalidConfigValue
from quadlog.geometry import roll_pitch_from_quat, rotation_from_quat, yaw_from_quat
from quadlog.messages import GRAVITY_MPS2, NS_PER_S, Float, Int
from quadlog.metrics.summary import Metric, Metrics
from quadlog.metrics.walking import drift_metrics
from quadlog.simulation.course_walk import EFFORT, FALLEN, POSE, REFERENCE, TICK_COLUMNS
from quadlog.simulation.robot.height_field import FRICTION, flat
from quadlog.simulation.robot.model import QuadrupedModel, add_world, describe, quadruped_spec
from quadlog.simulation.robot.model_files import without_log
from quadlog.simulation.robot.walking_robot import FALLEN_HEIGHT_SHARE, FALLEN_TILT_RAD
from quadlog.simulation.settings import Simulation

CURVES = ("baseline", "3d-curve")
"""Swings without and with y(t): experiments one and two of the paper."""
FRICTION_SPREAD, RADIUS_SPREAD, POSTURE_SPREAD_RAD = 0.25, 0.1, math.radians(1.0)
"""Within which of its plan a seed draws each number, evenly; ours."""
REST_S, TROT_S = 2.0, 30.0
PERIOD_S, STEP_M, LIFT_M = 1.0, 0.04, 0.02
"""T, S and H [Foot, section 4]; half of the period is swing."""
HEIGHT_M = 0.2
"""[Foot, Table 2]; its section 4 gives none."""
GAIN_NM_PER_RAD, DAMPING_NMS_PER_RAD = 300.0, 6.0
LEG_KG, TRUNK_KG = 0.4, 8.4
"""[Foot, section 4]: 10 kg in all, 0.4 kg a leg."""
PAIRS: Int = np.array([0, 1, 1, 0])
"""Of each leg: whether it swings with the left fore leg, or with the right one."""
# With 2 ms a symmetric robot turns by up to 0.007 degrees a second, with 1 ms by less than a third of that.
TIMESTEP_S = 0.001
SAMPLES_HZ = 50
"""Rate of the samples that are kept."""
SAMPLE_TICKS = round(1 / (SAMPLES_HZ * TIMESTEP_S))
# A leg is its thigh and its shank [Foot, below eq. 7], even rods; but MuJoCo needs a mass for every link.
_ABDUCTION_KG, _ABDUCTION_KGM2 = 1e-6, 1e-6
_ROD_RADIUS_M, _PAYLOAD_RADIUS_M = 0.012, 0.03
# Initial gap between feet and ground.
_GAP_M = 1e-4
# Beside the seed itself, which draws grounds; 1 draws disturbances.
_TROTS = 2


@dataclass(frozen=True, slots=True)
class FootCycle:
    """A foot's cycle [Foot, eqs 9-12, corrected]: a swing for swing_share (lambda) of period_s, then a stance back.

    A swing is a compound cycloid on and up, and a bulge aside: 4 s (1 - s), eq. 12's y(t) over its peak, whose speed is
    not 0 at the ends. step_m: S, how far it is carried on; lift_m: H; aside_m: the peak of y(t), left positive.
    """

    period_s: float
    step_m: float
    lift_m: float
    swing_share: float = 0.5
    aside_m: float = 0.0

    def at(self, t_s: Float) -> Float:
        """Positions (N, 3) at times (N,) from a lift-off on, about the middle of the step, level with the ground."""
        cycle = np.mod(np.asarray(t_s, np.float64) / self.period_s, 1.0)
        swings = cycle < self.swing_share
        s = np.where(swings, cycle / self.swing_share, (cycle - self.swing_share) / (1.0 - self.swing_share))
        on_m = self.step_m * _cycloid(s) - 0.5 * self.step_m
        aside_m, up_m = self.aside_m * (4.0 * s * (1.0 - s)), _cycloid(2.0 * np.minimum(s, 1.0 - s))
        return np.column_stack([np.where(swings, on_m, -on_m), swings * aside_m, swings * (self.lift_m * up_m)])


def _cycloid(s: Float) -> Float:
    """From 0 to 1, at rest at both ends."""
    return s - np.sin(2.0 * np.pi * s) / (2.0 * np.pi)


def lateral_peak_m(moment_nm: float, k: float, hip_inertia_kgm2: float, period_s: float) -> float:
    """The peak of y(t) = M / (4 k J1) t (t - T/2), which solves 2 J1 k y'' = M, y(0) = y(T/2) = 0 [Foot, eqs 11-12].

    moment_nm: M, about x on the body while the other pair stands; its sign alternates with the pair, and so does the
    peak's. hip_inertia_kgm2: J1, of a leg about its abduction axis. As printed, k has the unit 1/m, and half of
    period_s is swing.
    """
    return -moment_nm * period_s**2 / (64.0 * k * hip_inertia_kgm2)


@dataclass(frozen=True, slots=True)
class TrotRobot:
    """How the robot differs from its symmetric plan; its controller knows the plan only.

    payload_kg: on top of the trunk, payload_x_m ahead and payload_y_m left of its middle. leg_mass_spread: left legs
    are heavier by this share, right ones lighter. hip_offset_m: left hips sit so far ahead, right ones so far behind.
    """

    friction: float = FRICTION
    foot_radius_m: float = ROBOTS["foot"].foot_radius_m
    payload_kg: float = 0.0
    payload_x_m: float = 0.0
    payload_y_m: float = 0.0
    leg_mass_spread: float = 0.0
    hip_offset_m: float = 0.0

    @property
    def plan(self) -> Robot:
        """The robot as its controller knows it. Of its masses only the sum counts here: see trot_model."""
        return replace(ROBOTS["foot"], standing_height_m=HEIGHT_M)


def trot_model(robot: TrotRobot) -> QuadrupedModel:
    """The world of one such robot on level ground. Sensors: the torques of joints (12,), then the feet's loads (4,)."""
    body = replace(robot.plan, trunk_mass_kg=TRUNK_KG, foot_radius_m=robot.foot_radius_m)
    spec = quadruped_spec(body, robot.friction)
    add_world(spec, flat(), robot.friction, TIMESTEP_S)
    for leg, side in zip(LEGS, SIDES.tolist(), strict=True):
        abduction = spec.body(f"{leg}_abduction")
        abduction.pos = abduction.pos + np.array([side * robot.hip_offset_m, 0.0, 0.0])
        abduction.explicitinertial, abduction.mass, abduction.inertia = True, _ABDUCTION_KG, np.full(3, _ABDUCTION_KGM2)
        rod_kg = (1 + side * robot.leg_mass_spread) * LEG_KG / 2
        for name, length_m in zip(("thigh", "shank"), body.lengths_m[1:], strict=True):
            rod, across = spec.body(f"{leg}_{name}"), rod_kg * (3 * _ROD_RADIUS_M**2 + length_m**2) / 12
            rod.explicitinertial, rod.mass, rod.ipos = True, rod_kg, np.array([0.0, 0.0, -length_m / 2])
            rod.inertia = np.array([across, across, rod_kg * _ROD_RADIUS_M**2 / 2])
    if robot.payload_kg > 0:
        place = [robot.payload_x_m, robot.payload_y_m, body.trunk_m[2] / 2 + _PAYLOAD_RADIUS_M]
        ball = {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": [_PAYLOAD_RADIUS_M, 0, 0], "mass": robot.payload_kg}
        spec.body("trunk").add_body(name="payload", pos=place).add_geom(**ball, contype=0, conaffinity=0)
    _drive(spec, robot.foot_radius_m)
    return describe(spec.compile(), body, flat())


def _drive(spec: mujoco.MjSpec, foot_radius_m: float) -> None:
    """Make each motor a position servo, and add sensors of joint torques and foot loads."""
    kinds, objects = mujoco.mjtSensor, mujoco.mjtObj
    for motor in spec.actuators:
        motor.set_to_position(kp=GAIN_NM_PER_RAD, kv=DAMPING_NMS_PER_RAD)
        motor.ctrllimited = False
        force = {"type": kinds.mjSENS_ACTUATORFRC, "objtype": objects.mjOBJ_ACTUATOR}
        spec.add_sensor(name=motor.name, objname=motor.name, **force)
    for leg in LEGS:
        # A touch sensor feels the contacts inside of its site.
        site = spec.site(f"{leg}_foot")
        site.type, site.size = mujoco.mjtGeom.mjGEOM_SPHERE, [1.5 * foot_radius_m, 0, 0]
        load = {"type": kinds.mjSENS_TOUCH, "objtype": objects.mjOBJ_SITE}
        spec.add_sensor(name=f"{leg}_load", objname=site.name, **load)


def gravity_moment_nm(model: QuadrupedModel) -> float:
    """M: gravity's moment about x on the standing body while left fore and right hind foot carry [Foot, eq. 8].

    It is the part along x of the moment about the support diagonal, of D^2 = length^2 + width^2.
    """
    ahead_m = float(model.robot.centre_of_mass_m[0])
    length_m, width_m = (float(np.ptp(model.robot.standing_feet_m[:, axis])) for axis in (0, 1))
    weight_n = float(model.model.body_subtreemass[0]) * GRAVITY_MPS2
    return weight_n * ahead_m * width_m * length_m / (length_m**2 + width_m**2)


def hip_inertia_kgm2(model: QuadrupedModel) -> float:
    """J1: of a leg about its abduction axis as the robot stands, without the motor's rotor; the mean of the four."""
    data, world = mujoco.MjData(model.model), model.model
    data.qpos[model.joint_qpos] = model.robot.standing_joints_rad
    mujoco.mj_forward(world, data)
    full = np.zeros((world.nv, world.nv))
    mujoco.mj_fullM(world, data, full)
    abductions = model.joint_qvel[:: len(JOINTS)]
    return float(np.mean(full[abductions, abductions] - world.dof_armature[abductions]))


def joint_targets(plan: Robot, asides_m: Float, first_pair: int = 0) -> Float:
    """(N, 12) target angle of every joint at each tick. Raises InvalidConfigValue for a curve out of the legs' reach.

    asides_m: (4,) the peak of each leg's y(t), left positive; first_pair: of PAIRS, which swings first. While it rests
    the robot already stands as the first step begins, the first pair's feet half a step behind.
    """
    ticks = round(PERIOD_S / TIMESTEP_S)
    t_s = np.arange(ticks) * TIMESTEP_S
    feet = np.repeat(plan.standing_feet_m[None], ticks, axis=0)
    for leg in range(4):
        cycle = FootCycle(PERIOD_S, STEP_M, LIFT_M, aside_m=float(asides_m[leg]))
        feet[:, leg] += cycle.at(t_s + (0.0 if PAIRS[leg] == first_pair else PERIOD_S / 2))
    joints = np.empty((ticks, 12))
    for tick in range(ticks):
        if not joints_for(feet[tick], plan.hips_m, plan.lengths, joints[tick]):
            reason = f"a foot {1e3 * float(np.abs(asides_m).max()):.0f} mm aside is out of the legs' reach"
            raise InvalidConfigValue("simulation.trot.foot_curve_k", reason, "simulate trot-32s")
    resting = np.zeros(round(REST_S / TIMESTEP_S), np.int64)
    trotting = np.arange(round(TROT_S / TIMESTEP_S)) % ticks
    return joints[np.concatenate([resting, trotting])]


@dataclass(frozen=True, slots=True, eq=False)
class PlannedTrot:
    """The robot as it is, what its joints are sent to (N, 12) and how far they start beside, and the peak of y(t)."""

    robot: TrotRobot
    targets_rad: Float
    posture_rad: Float
    peak_m: float


def plan_trot(simulation: Simulation, curve: str, seed: int) -> PlannedTrot:
    """What a seed draws, and one of CURVES for it. Raises as joint_targets."""
    trot, plan, rng = simulation.trot, TrotRobot(), np.random.default_rng([seed, _TROTS])
    friction, radius = rng.uniform(-1.0, 1.0, 2).tolist()
    posture_rad = POSTURE_SPREAD_RAD * rng.uniform(-1.0, 1.0, len(LEGS) * len(JOINTS))
    robot = replace(
        plan,
        friction=simulation.friction * (1 + FRICTION_SPREAD * friction),
        foot_radius_m=plan.foot_radius_m * (1 + RADIUS_SPREAD * radius),
        **trot.model_dump(exclude={"foot_curve_k"}),
    )
    peak_m = 0.0
    if curve == "3d-curve":  # of right fore and left hind leg, by the planned robot, which does not know its payload
        model = trot_model(plan)
        peak_m = lateral_peak_m(gravity_moment_nm(model), trot.foot_curve_k, hip_inertia_kgm2(model), PERIOD_S)
    targets = joint_targets(plan.plan, np.where(PAIRS == 1, peak_m, -peak_m))
    return PlannedTrot(robot, targets, posture_rad, peak_m)


def walk_trot(model: QuadrupedModel, targets: Float, posture_rad: Float) -> dict[str, Any]:
    """The columns of control.parquet: joint targets (N, 12), initial joints offset by posture_rad (12,) from the first.

    There is no course, hence no reference, no error and no command. A fall is a result.
    """
    data, world = mujoco.MjData(model.model), model.model
    data.qpos[model.joint_qpos] = targets[0] + posture_rad
    mujoco.mj_kinematics(world, data)
    # So high that the lowest foot just touches.
    lowest_m = float(data.site_xpos[model.foot_sites, 2].min()) - model.robot.foot_radius_m
    data.qpos[2] += _GAP_M - lowest_m
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.empty(mujoco.mj_stateSize(world, full))
    mujoco.mj_getState(world, data, start, full)
    with without_log():
        states, sensors = rollout.rollout(world, data, start, targets)
    # Samples of states after each tick, beginning before the first; loads and torques of the tick before.
    kept = np.vstack([start, states[0, SAMPLE_TICKS - 1 :: SAMPLE_TICKS]])
    felt = np.vstack([np.zeros(16), sensors[0, SAMPLE_TICKS - 1 :: SAMPLE_TICKS]])
    qpos, qvel = kept[:, 1 : 1 + world.nq], kept[:, 1 + world.nq : 1 + world.nq + world.nv]
    quat_xyzw = qpos[:, [4, 5, 6, 3]]
    tilt, yaw = roll_pitch_from_quat(quat_xyzw), yaw_from_quat(quat_xyzw)
    cos, sin, (vx, vy) = np.cos(yaw), np.sin(yaw), qvel[:, :2].T
    # The third row of the body's rotation: how fast it turns about map's z.
    turn_radps = (rotation_from_quat(quat_xyzw)[:, 2] * qvel[:, 3:6]).sum(axis=1)
    motion = [*qpos[:, :3].T, *tilt.T, yaw, cos * vx + sin * vy, cos * vy - sin * vx, turn_radps]
    low = qpos[:, 2] < FALLEN_HEIGHT_SHARE * model.robot.standing_height_m
    return {
        "t_ns": np.arange(len(kept), dtype=np.int64) * (NS_PER_S // SAMPLES_HZ),
        **dict(zip(TICK_COLUMNS[POSE:REFERENCE], motion, strict=True)),
        **dict(zip(TICK_COLUMNS[EFFORT:FALLEN], felt.T, strict=True)),
        "fallen": np.logical_or.accumulate(low | (np.abs(tilt).max(axis=1) > FALLEN_TILT_RAD)),
    }


def trot_metrics(control: Mapping[str, Any]) -> Metrics:
    """Drift, ranges, a fall and the largest torque of a walk's columns."""
    position_m, rpy_rad, torques_nm = (
        np.column_stack([control[name] for name in TICK_COLUMNS[begin : begin + count]])
        for begin, count in ((POSE, 3), (POSE + 3, 3), (EFFORT, 12))
    )
    rest, period = (round(seconds * SAMPLES_HZ) for seconds in (REST_S, PERIOD_S))
    metrics = drift_metrics(position_m, rpy_rad, control["fallen"], rest, period, PERIOD_S)
    return metrics | {"torque_max_nm": Metric(float(np.abs(torques_nm).max()), torques_nm.size, "N·m")}
