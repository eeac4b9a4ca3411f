"""The experiment of [Foot, section 4]: a robot that trots by joint targets, what a seed draws for it, and how it
walks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from quadlog.control.locomotion.foot_trajectory import FootCycle
from quadlog.control.locomotion.kinematics import joints_for
from quadlog.control.locomotion.leg_dynamics import LEFT_FORE_RIGHT_HIND, diagonal_moment
from quadlog.control.locomotion.robot import JOINTS, LEGS, ROBOTS, SIDES, Robot
from quadlog.geometry import roll_pitch_from_quat, rotation_from_quat, yaw_from_quat
from quadlog.messages import GRAVITY_MPS2, NS_PER_S, Float, Int
from quadlog.simulation.course_walk import EFFORT, FALLEN, POSE, REFERENCE, TICK_COLUMNS
from quadlog.simulation.robot.height_field import FRICTION, flat
from quadlog.simulation.robot.model import QuadrupedModel, add_world, describe, mjcf
from quadlog.simulation.robot.model_files import without_log
from quadlog.simulation.robot.walking_robot import FALLEN_HEIGHT_SHARE, FALLEN_TILT_RAD


@dataclass(frozen=True, slots=True)
class Draw:
    """friction_share, radius_share: by how much these are off, as shares. postures_rad: (12,) how far joints are."""

    friction_share: float
    radius_share: float
    postures_rad: Float


FRICTION_SPREAD, RADIUS_SPREAD, POSTURE_SPREAD_RAD = 0.25, 0.1, math.radians(1.0)
"""Within which of 0 a seed draws each number of a Draw, evenly; ours."""


def draw_trot(seed: int) -> Draw:
    """What a seed draws."""
    rng = np.random.default_rng([seed, _TROTS])
    friction, radius = rng.uniform(-1.0, 1.0, 2).tolist()
    postures = rng.uniform(-1.0, 1.0, len(LEGS) * len(JOINTS))
    return Draw(FRICTION_SPREAD * friction, RADIUS_SPREAD * radius, POSTURE_SPREAD_RAD * postures)


# Beside the seed itself, which draws grounds; 1 draws disturbances.
_TROTS = 2

GAIN_NM_PER_RAD, DAMPING_NMS_PER_RAD = 300.0, 6.0
LEG_KG, TRUNK_KG = 0.4, 8.4
"""[Foot, section 4]: 10 kg in all, 0.4 kg a leg."""
# With 2 ms a symmetric robot turns by up to 0.007 degrees a second, with 1 ms by less than a third of that.
TIMESTEP_S = 0.001
HEIGHT_M = 0.2
"""[Foot, Table 2]; its section 4 gives none."""
# A leg is its thigh and its shank [Foot, below eq. 7], even rods; but MuJoCo needs a mass for every link.
_ABDUCTION_KG, _ABDUCTION_KGM2 = 1e-6, 1e-6
_ROD_RADIUS_M, _PAYLOAD_RADIUS_M = 0.012, 0.03
# Initial gap between feet and ground.
_GAP_M = 1e-4


@dataclass(frozen=True, slots=True)
class TrotRobot:
    """How the robot differs from its symmetric plan; its controller knows the plan only.

    payload_kg: on top of the trunk, payload_x_m ahead and payload_y_m left of its middle. leg_mass_spread: left legs
    are heavier by this share, right ones lighter. hip_offset_m: left hips sit so far ahead, right ones so far behind.
    """

    height_m: float = HEIGHT_M
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
        return replace(ROBOTS["foot"], standing_height_m=self.height_m)


def trot_model(robot: TrotRobot) -> QuadrupedModel:
    """The world of one such robot on level ground. Sensors: the torques of joints (12,), then the feet's loads (4,)."""
    body = replace(robot.plan, trunk_mass_kg=TRUNK_KG, foot_radius_m=robot.foot_radius_m)
    spec = mujoco.MjSpec.from_string(mjcf(body, robot.friction))
    add_world(spec, flat(), robot.friction, TIMESTEP_S)
    for leg, side in zip(LEGS, SIDES.tolist(), strict=True):
        _weigh(spec, leg, (1 + side * robot.leg_mass_spread) * LEG_KG / 2, body)
        hip = spec.body(f"{leg}_abduction")
        hip.pos = hip.pos + np.array([side * robot.hip_offset_m, 0.0, 0.0])
    if robot.payload_kg > 0:
        _load(spec, robot, body)
    _drive(spec, robot.foot_radius_m)
    return describe(spec.compile(), body, flat())


def gravity_moment_nm(model: QuadrupedModel) -> float:
    """M: gravity's moment about x on the standing body while left fore and right hind foot carry [Foot, eq. 8]."""
    data, robot = _standing(model), model.robot
    ahead_m = float(data.subtree_com[model.trunk_body][0] - data.xpos[model.trunk_body][0])
    length_m, width_m = (float(np.ptp(robot.standing_feet_m[:, axis])) for axis in (0, 1))
    weight_n = float(model.model.body_subtreemass[0]) * GRAVITY_MPS2
    return float(diagonal_moment(weight_n, ahead_m, length_m, width_m, LEFT_FORE_RIGHT_HIND)[0])


def hip_inertia_kgm2(model: QuadrupedModel) -> float:
    """J1: of a leg about its abduction axis as the robot stands, without the motor's rotor; the mean of the four."""
    data, world = _standing(model), model.model
    full = np.zeros((world.nv, world.nv))
    mujoco.mj_fullM(world, data, full)
    abductions = model.joint_qvel[:: len(JOINTS)]
    return float(np.mean(full[abductions, abductions] - world.dof_armature[abductions]))


def _standing(model: QuadrupedModel) -> mujoco.MjData:
    data = mujoco.MjData(model.model)
    data.qpos[model.joint_qpos] = model.robot.standing_joints_rad
    mujoco.mj_forward(model.model, data)
    return data


def _weigh(spec: mujoco.MjSpec, leg: str, rod_kg: float, body: Robot) -> None:
    """Thigh and shank of rod_kg each, and an abduction link of next to nothing."""
    abduction = spec.body(f"{leg}_abduction")
    abduction.mass, abduction.inertia = _ABDUCTION_KG, np.full(3, _ABDUCTION_KGM2)
    for name, length_m in zip(("thigh", "shank"), body.lengths_m[1:], strict=True):
        across = rod_kg * (3 * _ROD_RADIUS_M**2 + length_m**2) / 12
        rod = spec.body(f"{leg}_{name}")
        rod.mass, rod.ipos = rod_kg, np.array([0.0, 0.0, -length_m / 2])
        rod.inertia = np.array([across, across, rod_kg * _ROD_RADIUS_M**2 / 2])


def _load(spec: mujoco.MjSpec, robot: TrotRobot, body: Robot) -> None:
    place = [robot.payload_x_m, robot.payload_y_m, body.trunk_m[2] / 2 + _PAYLOAD_RADIUS_M]
    payload = spec.body("trunk").add_body(name="payload", pos=place, mass=robot.payload_kg, explicitinertial=True)
    # The default would be the body's origin.
    payload.ipos = np.zeros(3)
    payload.inertia = np.full(3, 0.4 * robot.payload_kg * _PAYLOAD_RADIUS_M**2)
    ball = payload.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[_PAYLOAD_RADIUS_M, 0, 0], contype=0, conaffinity=0)
    ball.mass, ball.rgba = 0.0, [0.84, 0.37, 0.0, 1.0]


def _drive(spec: mujoco.MjSpec, foot_radius_m: float) -> None:
    """Make each motor a position servo, and add sensors of joint torques and foot loads."""
    for motor in spec.actuators:
        motor.set_to_position(kp=GAIN_NM_PER_RAD, kv=DAMPING_NMS_PER_RAD)
        motor.ctrllimited = False
        spec.add_sensor(
            name=motor.name, type=mujoco.mjtSensor.mjSENS_ACTUATORFRC, objtype=mujoco.mjtObj.mjOBJ_ACTUATOR
        ).objname = motor.name
    for leg in LEGS:
        # A touch sensor feels the contacts inside of its site.
        site = spec.site(f"{leg}_foot")
        site.type, site.size = mujoco.mjtGeom.mjGEOM_SPHERE, [1.5 * foot_radius_m, 0, 0]
        spec.add_sensor(
            name=f"{leg}_load", type=mujoco.mjtSensor.mjSENS_TOUCH, objtype=mujoco.mjtObj.mjOBJ_SITE
        ).objname = site.name


def start_qpos(model: QuadrupedModel, joints_rad: Float) -> Float:
    """(nq,) the trunk level at the origin, joints (12,) as given, so high that the lowest foot just touches."""
    data = mujoco.MjData(model.model)
    data.qpos[model.joint_qpos] = joints_rad
    mujoco.mj_kinematics(model.model, data)
    lowest_m = float(data.site_xpos[model.foot_sites, 2].min()) - model.robot.foot_radius_m
    qpos: Float = data.qpos.copy()
    qpos[2] += _GAP_M - lowest_m
    return qpos


REST_S, TROT_S = 2.0, 30.0
PERIOD_S, STEP_M, LIFT_M = 1.0, 0.04, 0.02
"""T, S and H [Foot, section 4]; half of the period is swing."""
PAIRS: Int = np.array([0, 1, 1, 0])
"""Of each leg: 0 with the left fore one, 1 with the right fore one."""
SAMPLES_HZ = 50
"""Rate of the samples that are kept."""
SAMPLE_TICKS = round(1 / (SAMPLES_HZ * TIMESTEP_S))


class OutOfReach(ValueError):
    """A commanded foot position is out of the legs' reach."""


@dataclass(frozen=True, slots=True, eq=False)
class TrotWalk:
    """The recorded walk, T samples: columns of control.parquet, and MuJoCo's coordinates (T, nq)."""

    t_ns: Int
    position_m: Float
    rpy_rad: Float
    velocity_mps: Float
    yaw_rate_radps: Float
    torques_nm: Float
    loads_n: Float
    fallen: NDArray[np.bool_]
    qpos: Float

    def columns(self) -> dict[str, NDArray[Any]]:
        """By the names of control.parquet. There is no course, hence no reference, no error and no command."""
        motion = np.column_stack([self.position_m, self.rpy_rad, self.velocity_mps, self.yaw_rate_radps])
        return {
            "t_ns": self.t_ns,
            **dict(zip(TICK_COLUMNS[POSE:REFERENCE], motion.T, strict=True)),
            **dict(zip(TICK_COLUMNS[EFFORT:FALLEN], np.column_stack([self.torques_nm, self.loads_n]).T, strict=True)),
            "fallen": self.fallen,
        }


def joint_targets(plan: Robot, asides_m: Float, first_pair: int = 0) -> Float:
    """(N, 12) target angle of every joint at each tick; raises OutOfReach.

    asides_m: (4,) the peak of each leg's y(t), left positive; first_pair: of PAIRS, which swings first. While it rests
    the robot already stands as the first step begins, the first pair's feet half a step behind.
    """
    ticks = round(PERIOD_S / TIMESTEP_S)
    t_s = np.arange(ticks) * TIMESTEP_S
    feet = np.repeat(plan.standing_feet_m[None], ticks, axis=0)
    for leg in range(4):
        cycle = FootCycle(PERIOD_S, STEP_M, LIFT_M, aside_m=float(asides_m[leg]))
        later_s = 0.0 if PAIRS[leg] == first_pair else PERIOD_S / 2
        feet[:, leg] += cycle.at(t_s + later_s)
    joints = np.empty((ticks, 12))
    for tick in range(ticks):
        if not joints_for(feet[tick], plan.hips_m, plan.lengths, joints[tick]):
            raise OutOfReach(f"a foot {1e3 * float(np.abs(asides_m).max()):.0f} mm aside is out of the legs' reach")
    resting = np.zeros(round(REST_S / TIMESTEP_S), np.int64)
    trotting = np.arange(round(TROT_S / TIMESTEP_S)) % ticks
    return joints[np.concatenate([resting, trotting])]


def walk_trot(model: QuadrupedModel, targets: Float, posture_rad: Float) -> TrotWalk:
    """Run the experiment: joint targets (N, 12), initial joint angles offset by posture_rad (12,) from the first.

    A fall is a result.
    """
    data, world = mujoco.MjData(model.model), model.model
    data.qpos[:] = start_qpos(model, targets[0] + posture_rad)
    controls = np.zeros_like(targets)
    controls[:, model.actuators] = targets
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.empty(mujoco.mj_stateSize(world, full))
    mujoco.mj_getState(world, data, start, full)
    with without_log():
        states, sensors = rollout.rollout(world, data, start, controls)
    return sampled(model, start, states[0], sensors[0])


def sampled(model: QuadrupedModel, start: Float, states: Float, sensors: Float) -> TrotWalk:
    """Samples of states (N, ...) after each tick, beginning before the first; loads and torques of the tick before."""
    nq, nv = model.model.nq, model.model.nv
    kept = np.vstack([start, states[SAMPLE_TICKS - 1 :: SAMPLE_TICKS]])
    felt = np.vstack([np.zeros(sensors.shape[1]), sensors[SAMPLE_TICKS - 1 :: SAMPLE_TICKS]])
    qpos, qvel = kept[:, 1 : 1 + nq], kept[:, 1 + nq : 1 + nq + nv]
    quat_xyzw = qpos[:, [4, 5, 6, 3]]
    tilt, yaw = roll_pitch_from_quat(quat_xyzw), yaw_from_quat(quat_xyzw)
    cos, sin, (vx, vy) = np.cos(yaw), np.sin(yaw), qvel[:, :2].T
    # The third row of the body's rotation: how fast it turns about map's z.
    upward = rotation_from_quat(quat_xyzw)[:, 2]
    low = qpos[:, 2] < FALLEN_HEIGHT_SHARE * model.robot.standing_height_m
    down = low | (np.abs(tilt).max(axis=1) > FALLEN_TILT_RAD)
    return TrotWalk(
        t_ns=np.arange(len(kept), dtype=np.int64) * (NS_PER_S // SAMPLES_HZ),
        position_m=qpos[:, :3],
        rpy_rad=np.column_stack([tilt, yaw]),
        velocity_mps=np.column_stack([cos * vx + sin * vy, cos * vy - sin * vx]),
        yaw_rate_radps=(upward * qvel[:, 3:6]).sum(axis=1),
        torques_nm=felt[:, model.actuators],
        loads_n=felt[:, 12:16],
        fallen=np.logical_or.accumulate(down),
        qpos=qpos,
    )
