"""The robot of [Foot]'s experiment in MuJoCo, its joints driven to angles; and how it may differ from its plan."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from quadlog.locomotion.diagonal_moment import LEFT_FORE_RIGHT_HIND, diagonal_moment
from quadlog.locomotion.robot import GRAVITY_MPS2, JOINTS, LEGS, ROBOTS, SIDES, Robot
from quadlog.messages import Float
from quadlog.simulation.ground import FRICTION, flat
from quadlog.simulation.quadruped_model import QuadrupedModel, add_world, describe, mjcf

GAIN_NM_PER_RAD, DAMPING_NMS_PER_RAD = 300.0, 6.0
LEG_KG, TRUNK_KG = 0.4, 8.4
"""[Foot, section 4]: 10 kg in all, 0.4 kg a leg."""
# With 2 ms a symmetric robot turns by up to 0.007 degrees a second, with 1 ms by less than a third of that.
TIMESTEP_S = 0.001
HEIGHT_M = 0.2
"""[Foot, Table 2]; its section 4 gives none."""
# A leg is its thigh and its shank [Foot, below eq. 7], even rods; but MuJoCo wants every link to weigh something.
_ABDUCTION_KG, _ABDUCTION_KGM2 = 1e-6, 1e-6
_ROD_RADIUS_M, _PAYLOAD_RADIUS_M = 0.012, 0.03
# Nothing may start inside of another thing.
_GAP_M = 1e-4


@dataclass(frozen=True, slots=True)
class TrotRobot:
    """What the robot is beside its plan, which is symmetric; its controller knows the plan alone.

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
    # Unless it is said, MuJoCo takes the body's place for that of the mass in it.
    payload.ipos = np.zeros(3)
    payload.inertia = np.full(3, 0.4 * robot.payload_kg * _PAYLOAD_RADIUS_M**2)
    ball = payload.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[_PAYLOAD_RADIUS_M, 0, 0], contype=0, conaffinity=0)
    ball.mass, ball.rgba = 0.0, [0.84, 0.37, 0.0, 1.0]


def _drive(spec: mujoco.MjSpec, foot_radius_m: float) -> None:
    """Each motor holds its joint at an angle; and what tells torques and loads."""
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
