"""A robot on its ground, as MuJoCo simulates it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from quadlog.control.locomotion.body_reference import fit_plane, slope_angles
from quadlog.control.locomotion.kinematics import foot_positions, joints_for
from quadlog.control.locomotion.robot import JOINTS, LEGS, SIDES, Robot
from quadlog.messages import GRAVITY_MPS2, Float, Int
from quadlog.simulation.robot.height_field import FRICTION, HeightField

TIMESTEP_S = 0.002
_GAP_M = 1e-4
"""Initial gap between feet and ground, so that no contact starts in penetration."""
_OTHER_FRICTION = (0.005, 0.0001)
"""Twisting and rolling: MuJoCo's defaults, unused by contacts of three dimensions."""
_RISE_RADII = np.linspace(0.0, 1.0, 5)
ARMATURE_KGM2 = 0.01
AXES = ((1, 0, 0), (0, -1, 0), (0, -1, 0))
JOINT_NAMES = tuple(f"{leg}_{joint}" for leg in LEGS for joint in JOINTS)
_LINKS, _RADII_M, _CENTRES = ("abduction", "thigh", "shank"), (0.045, 0.045, 0.012), (0.5, 0.15, 0.5)
"""Of a leg, a ball and two rods about a share of the way to their ends."""


@dataclass(frozen=True, eq=False)
class QuadrupedModel:
    """A compiled model, and where in it things are; legs in the order of LEGS, joints 3 * leg + k.

    Its joints turn as quadlog.control.locomotion.kinematics has them. qpos begins with the trunk's position and
    quaternion wxyz, qvel with its velocity in map and its angular velocity in the body.
    joint_qpos, joint_qvel: (12,); foot_sites, foot_geoms: (4,). Motors are in the order of joints.
    """

    robot: Robot
    ground: HeightField
    model: mujoco.MjModel
    joint_qpos: Int
    joint_qvel: Int
    foot_sites: Int
    foot_geoms: Int
    trunk_body: int

    def standing_at(self, x_m: float, y_m: float, yaw_rad: float = 0.0) -> Float:
        """(nq,) qpos: the robot stands at a place in map, parallel to the ground under its feet, which just touch."""
        robot, feet = self.robot, self.robot.standing_feet_m
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        footprint = feet[:, :2] @ np.array([[cos, sin], [-sin, cos]]) + [x_m, y_m]
        contacts = np.column_stack([footprint, self.ground.height_at(footprint)])
        plane = np.empty(3)
        fit_plane(contacts, plane)
        roll, pitch = slope_angles(plane, yaw_rad)
        quat = np.empty(4)
        mujoco.mju_euler2Quat(quat, np.array([yaw_rad, pitch, roll]), "zyx")
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, quat)
        rotation = turn.reshape(3, 3)
        # The standing height is measured along the body's own axis, which may be tilted.
        position = np.array([x_m, y_m, plane @ [x_m, y_m, 1.0] + robot.standing_height_m / rotation[2, 2]])
        wanted = feet @ rotation.T + position
        joints, placed = np.empty(12), np.empty((4, 3))
        for _ in range(3):
            wanted[:, 2] = self._touching(wanted[:, :2])
            joints_for((wanted - position) @ rotation, robot.hips_m, robot.lengths, joints)
            foot_positions(joints, robot.hips_m, robot.lengths, placed)
            # Where a leg is too short, the whole robot comes down.
            position[2] += min(float(np.min(wanted[:, 2] - (placed @ rotation.T + position)[:, 2])), 0.0)
        qpos: Float = np.zeros(self.model.nq)
        qpos[:3], qpos[3:7] = position, quat
        qpos[self.joint_qpos] = joints
        self._lift_clear(qpos)
        return qpos

    def _lift_clear(self, qpos: Float) -> None:
        """Raise the robot until nothing penetrates: a ball may rest on an edge between the points that were tried."""
        data = mujoco.MjData(self.model)
        for _ in range(4):
            data.qpos[:] = qpos
            mujoco.mj_forward(self.model, data)
            deepest = min(data.contact.dist, default=0.0)
            if deepest >= 0:
                return
            qpos[2] += 1.5 * (_GAP_M - deepest)

    def _touching(self, xy_m: Float) -> Float:
        """(N,) height of a foot's centre at points (N, 2) so that its ball just clears the ground about it."""
        radius = self.robot.foot_radius_m
        angle = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
        ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        offsets = (radius * _RISE_RADII[:, None, None] * ring).reshape(-1, 2)
        up = np.sqrt(np.maximum(radius**2 - (offsets**2).sum(axis=1), 0.0))
        around = (xy_m[:, None] + offsets).reshape(-1, 2)
        return (self.ground.height_at(around).reshape(len(xy_m), -1) + up).max(axis=1) + _GAP_M


def quadruped_model(robot: Robot, ground: HeightField, friction: float = FRICTION) -> QuadrupedModel:
    """The world with one robot of quadlog's own."""
    spec = quadruped_spec(robot, friction)
    add_world(spec, ground, friction, TIMESTEP_S)
    return describe(spec.compile(), robot, ground)


def quadruped_spec(robot: Robot, friction: float = FRICTION) -> mujoco.MjSpec:
    """One of quadlog's own robots, without ground: see add_world.

    Its links are even balls and rods, ours, after common robots: the motors of hip and knee sit about the hip.
    """
    spec, shapes = mujoco.MjSpec(), mujoco.mjtGeom
    trunk = spec.worldbody.add_body(name="trunk", pos=[0, 0, robot.standing_height_m])
    trunk.add_freejoint(name="trunk")
    size = np.array(robot.trunk_m) / 2
    trunk.add_geom(name="trunk", type=shapes.mjGEOM_BOX, size=size, mass=robot.trunk_mass_kg, **touching(friction))
    if robot.trunk_inertia_kgm2 is not None:
        trunk.explicitinertial, trunk.mass, trunk.ipos = True, robot.trunk_mass_kg, robot.trunk_centre_m
        trunk.fullinertia = robot.trunk_inertia_kgm2
    aside_m, thigh_m, shank_m = robot.lengths_m
    for leg, side, place in zip(LEGS, SIDES.tolist(), robot.hips_m, strict=True):
        ends = np.array([[0, side * aside_m, 0], [0, 0, -thigh_m], [0, 0, -shank_m]])
        parent, form = trunk, shapes.mjGEOM_SPHERE
        for k, (link, end, radius_m, centre) in enumerate(zip(_LINKS, ends, _RADII_M, _CENTRES, strict=True)):
            parent = parent.add_body(name=f"{leg}_{link}", pos=place)
            parent.add_joint(name=f"{leg}_{JOINTS[k]}", axis=AXES[k], armature=ARMATURE_KGM2)
            even = {"type": form, "size": [radius_m, np.linalg.norm(end) / 2, 0], "mass": robot.link_masses_kg[k]}
            parent.add_geom(pos=centre * end, contype=0, conaffinity=0, **even)
            place, form = end, shapes.mjGEOM_CYLINDER
        add_foot(parent, leg, place, robot.foot_radius_m, friction).mass = robot.link_masses_kg[3]
    add_motors(spec, [robot.torque_limit_nm] * 12)
    return spec


def touching(friction: float) -> dict[str, Any]:
    """How shapes that meet the ground, and nothing else, do so."""
    return {"contype": 0, "conaffinity": 1, "condim": 3, "friction": [friction, *_OTHER_FRICTION]}


def add_foot(shank: Any, leg: str, place_m: Float, radius_m: float, friction: float) -> Any:
    """Put a ball without mass and a site at a place (3,) of a body; returns the ball."""
    shank.add_site(name=f"{leg}_foot", pos=place_m)
    ball = {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": [radius_m, 0, 0], "mass": 0.0}
    return shank.add_geom(name=f"{leg}_foot", pos=place_m, **ball, **touching(friction))


def add_motors(spec: mujoco.MjSpec, limits_nm: Sequence[float]) -> None:
    """Give every joint a torque within limits (12,): motor 3 * leg + k."""
    for name, limit_nm in zip(JOINT_NAMES, limits_nm, strict=True):
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        motor.ctrllimited = motor.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        motor.ctrlrange = motor.forcerange = [-limit_nm, limit_nm]


def describe(model: mujoco.MjModel, robot: Robot, ground: HeightField) -> QuadrupedModel:
    """Where things are in a model with the names of quadruped_spec, and its robot with the masses that it has.

    Without damping, of joints or servos, explicit steps are the same as implicit ones, and cost less.
    """
    if not (model.dof_damping.any() or model.actuator_biasprm[:, 2].any()):
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    joints = [model.joint(name) for name in JOINT_NAMES]
    joint_qpos = np.array([int(joint.qposadr[0]) for joint in joints])
    centre_m, inertia_kgm2 = _rigid_body(model, joint_qpos, robot.standing_joints_rad)
    return QuadrupedModel(
        robot=replace(robot, centre_of_mass_m=centre_m, inertia_kgm2=inertia_kgm2),
        ground=ground,
        model=model,
        joint_qpos=joint_qpos,
        joint_qvel=np.array([int(joint.dofadr[0]) for joint in joints]),
        foot_sites=np.array([model.site(f"{leg}_foot").id for leg in LEGS]),
        foot_geoms=np.array([model.geom(f"{leg}_foot").id for leg in LEGS]),
        trunk_body=model.body("trunk").id,
    )


def _rigid_body(model: mujoco.MjModel, joint_qpos: Int, joints_rad: Float) -> tuple[Float, Float]:
    """(3,) centre of mass in the body, and (3, 3) inertia about it, of a robot whose joints are held.

    They are in the trunk's 6 x 6 block of the mass matrix. Rotors, which turn about their own joints only, are not.
    """
    data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[:7], data.qpos[joint_qpos] = [0, 0, 0, 1, 0, 0, 0], joints_rad
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    mass_kg, moment = full[0, 0], full[:3, 3:6]
    centre_m = np.array([moment[1, 2], moment[2, 0], moment[0, 1]]) / mass_kg
    return centre_m, full[3:6, 3:6] - mass_kg * (centre_m @ centre_m * np.eye(3) - np.outer(centre_m, centre_m))


def add_world(spec: mujoco.MjSpec, ground: HeightField, friction: float, timestep_s: float) -> None:
    """Put a robot's specification into our world: the ground, and how time passes."""
    spec.option.timestep, spec.option.integrator = timestep_s, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0
    spec.option.gravity = [0.0, 0.0, -GRAVITY_MPS2]
    geom = spec.worldbody.add_geom(name="ground", friction=[friction, *_OTHER_FRICTION], contype=1, conaffinity=0)
    if ground.is_plane:
        (low, right), (left, _) = ground.height_m.astype(np.float64).tolist()
        level = float(ground.height_at(np.zeros((1, 2)))[0])
        geom.type, geom.size, geom.pos = mujoco.mjtGeom.mjGEOM_PLANE, [0, 0, 1], [0, 0, level]
        turn = np.empty(4)
        mujoco.mju_quatZ2Vec(turn, np.array([low - right, low - left, ground.cell_m]))
        geom.quat = turn
        return
    rows, cols = ground.height_m.shape
    half_m = np.array([cols - 1, rows - 1]) * ground.cell_m / 2
    low, high = float(ground.height_m.min()), float(ground.height_m.max())
    size = [*half_m, high - low or 1.0, 1.0]
    # MuJoCo scales heights to 0..1 by itself.
    spec.add_hfield(name="ground", nrow=rows, ncol=cols, size=size, userdata=ground.height_m.ravel())
    geom.type, geom.hfieldname = mujoco.mjtGeom.mjGEOM_HFIELD, "ground"
    geom.pos = [*(np.array(ground.origin_m) + half_m), low]
