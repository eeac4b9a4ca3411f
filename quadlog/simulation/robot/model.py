"""A robot on its ground, as MuJoCo simulates it."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from quadlog.control.locomotion.body_reference import fit_plane, slope_angles
from quadlog.control.locomotion.kinematics import foot_positions, joints_for
from quadlog.control.locomotion.robot import JOINTS, LEGS, SIDES, Link, Robot
from quadlog.messages import GRAVITY_MPS2, Float, Int
from quadlog.simulation.robot.height_field import FRICTION, HeightField

TIMESTEP_S = 0.002
_GAP_M = 1e-4
"""Initial gap between feet and ground, so that no contact starts in penetration."""
_OTHER_FRICTION = (0.005, 0.0001)
"""Twisting and rolling: MuJoCo's defaults, unused by contacts of three dimensions."""
_RISE_RADII = np.linspace(0.0, 1.0, 5)


@dataclass(frozen=True, eq=False)
class QuadrupedModel:
    """A compiled model, and where in it things are; legs in the order of LEGS, joints 3 * leg + k.

    Its joints turn as quadlog.control.locomotion.kinematics has them. qpos begins with the trunk's position and
    quaternion wxyz, qvel with its velocity in map and its angular velocity in the body.
    joint_qpos, joint_qvel, actuators: (12,); foot_sites, foot_geoms: (4,).
    """

    robot: Robot
    ground: HeightField
    model: mujoco.MjModel
    joint_qpos: Int
    joint_qvel: Int
    actuators: Int
    foot_sites: Int
    foot_geoms: Int
    trunk_body: int
    ground_geom: int

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
        """Raise the robot until nothing penetrates: MuJoCo's triangles differ a little from the bilinear surface."""
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
    spec = mujoco.MjSpec.from_string(mjcf(robot, friction))
    add_world(spec, ground, friction, TIMESTEP_S)
    model = spec.compile()
    fill_heights(model, ground)
    return describe(model, robot, ground)


def describe(model: mujoco.MjModel, robot: Robot, ground: HeightField) -> QuadrupedModel:
    """Where things are in a model whose names are those of mjcf.

    Without damping, of joints or servos, explicit steps are the same as implicit ones, and cost less.
    """
    if not (model.dof_damping.any() or model.actuator_biasprm[:, 2].any()):
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER

    def ids(kind: mujoco.mjtObj, names: list[str]) -> Int:
        return np.array([mujoco.mj_name2id(model, kind, name) for name in names])

    joint_names, feet = [f"{leg}_{joint}" for leg in LEGS for joint in JOINTS], [f"{leg}_foot" for leg in LEGS]
    joints, sites = ids(mujoco.mjtObj.mjOBJ_JOINT, joint_names), ids(mujoco.mjtObj.mjOBJ_SITE, feet)
    return QuadrupedModel(
        robot=robot,
        ground=ground,
        model=model,
        joint_qpos=model.jnt_qposadr[joints].astype(np.int64),
        joint_qvel=model.jnt_dofadr[joints].astype(np.int64),
        actuators=ids(mujoco.mjtObj.mjOBJ_ACTUATOR, joint_names),
        foot_sites=sites,
        foot_geoms=ids(mujoco.mjtObj.mjOBJ_GEOM, feet),
        trunk_body=int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "trunk")),
        ground_geom=int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "ground")),
    )


def mjcf(robot: Robot, friction: float = FRICTION) -> str:
    """The robot's text, without ground; see add_world."""
    legs = "\n".join(_leg(robot, leg, friction) for leg in range(4))
    limit = f"{-robot.torque_limit_nm!r} {robot.torque_limit_nm!r}"
    motors = "\n".join(
        f'    <motor name="{leg}_{joint}" joint="{leg}_{joint}" ctrllimited="true" ctrlrange="{limit}" '
        f'forcelimited="true" forcerange="{limit}"/>'
        for leg in LEGS
        for joint in JOINTS
    )
    return f"""<mujoco model="{robot.name}">
  <compiler angle="radian" autolimits="false"/>
  <statistic center="0 0 {robot.standing_height_m!r}" extent="2"/>
  <visual><global offwidth="1280" offheight="720"/></visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.9 0.93 1" rgb2="0.6 0.7 0.85" width="64" height="64"/>
  </asset>
  <worldbody>
    <body name="trunk" pos="0 0 {robot.standing_height_m!r}">
      <freejoint name="trunk"/>
      {_inertial(robot.trunk, 1.0)}
      <geom name="trunk" type="box" size="{_numbers(np.array(robot.trunk_m) / 2)}" rgba="0.25 0.3 0.35 1"
        friction="{_friction(friction)}" contype="0" conaffinity="1" condim="3"/>
{legs}
    </body>
  </worldbody>
  <actuator>
{motors}
  </actuator>
</mujoco>
"""


def add_world(spec: mujoco.MjSpec, ground: HeightField, friction: float, timestep_s: float) -> None:
    """Put a robot's specification into our world: the ground, and how time passes."""
    spec.option.timestep, spec.option.integrator = timestep_s, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0
    spec.option.gravity = [0.0, 0.0, -GRAVITY_MPS2]
    geom = spec.worldbody.add_geom(name="ground", friction=[friction, *_OTHER_FRICTION], contype=1, conaffinity=0)
    geom.rgba = [0.62, 0.6, 0.55, 1.0]
    spec.worldbody.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=[0, 0, 10], dir=[0.3, 0.2, -1])
    if ground.is_plane:
        rise_x, rise_y, level = ground.plane_at(0.0, 0.0)
        geom.type, geom.size, geom.pos = mujoco.mjtGeom.mjGEOM_PLANE, [0, 0, 1], [0, 0, level]
        turn = np.empty(4)
        mujoco.mju_quatZ2Vec(turn, np.array([-rise_x, -rise_y, 1.0]))
        geom.quat = turn
        return
    rows, cols = ground.height_m.shape
    half_m = np.array([cols - 1, rows - 1]) * ground.cell_m / 2
    low, height = _lowest_and_range(ground)
    spec.add_hfield(name="ground", nrow=rows, ncol=cols, size=[*half_m, height, 1.0], userdata=np.zeros(rows * cols))
    geom.type, geom.hfieldname = mujoco.mjtGeom.mjGEOM_HFIELD, "ground"
    geom.pos = [*(np.array(ground.origin_m) + half_m), low]


def fill_heights(model: mujoco.MjModel, ground: HeightField) -> None:
    """Put a ground's heights into a compiled model, unless it is a plane, which has none."""
    if not ground.is_plane:
        low, height = _lowest_and_range(ground)
        model.hfield_data[:] = ((ground.height_m.astype(np.float64) - low) / height).astype(np.float32).ravel()


def _lowest_and_range(ground: HeightField) -> tuple[float, float]:
    low, high = float(ground.height_m.min()), float(ground.height_m.max())
    return low, max(high - low, 1e-3)


def _leg(robot: Robot, leg: int, friction: float) -> str:
    name, side = LEGS[leg], float(SIDES[leg])
    aside_m, thigh_m, shank_m = robot.lengths_m
    abduction, thigh, shank = (_inertial(link, side) for link in robot.links)

    def joint(kind: str, axis: str) -> str:
        return f'<joint name="{name}_{kind}" type="hinge" axis="{axis}" armature="{robot.armature_kgm2!r}"/>'

    seen = 'contype="0" conaffinity="0" rgba="0.55 0.57 0.6 1" mass="0"'
    return f"""      <body name="{name}_abduction" pos="{_numbers(robot.hips_m[leg])}">
        {joint("abduction", "1 0 0")}
        {abduction}
        <geom type="capsule" fromto="0 0 0 0 {side * aside_m!r} 0" size="0.035" {seen}/>
        <body name="{name}_thigh" pos="0 {side * aside_m!r} 0">
          {joint("hip", "0 -1 0")}
          {thigh}
          <geom type="capsule" fromto="0 0 0 0 0 {-thigh_m!r}" size="0.018" {seen}/>
          <body name="{name}_shank" pos="0 0 {-thigh_m!r}">
            {joint("knee", "0 -1 0")}
            {shank}
            <geom type="capsule" fromto="0 0 0 0 0 {-shank_m!r}" size="0.011" {seen}/>
            <geom name="{name}_foot" type="sphere" size="{robot.foot_radius_m!r}" pos="0 0 {-shank_m!r}" mass="0"
              friction="{_friction(friction)}" contype="0" conaffinity="1" condim="3" rgba="0.1 0.1 0.1 1"/>
            <site name="{name}_foot" pos="0 0 {-shank_m!r}" size="0.005"/>
          </body>
        </body>
      </body>"""


def _inertial(link: Link, side: float) -> str:
    centre = _numbers(link.centre_m * np.array([1.0, side, 1.0]))
    return f'<inertial pos="{centre}" mass="{link.mass_kg!r}" diaginertia="{_numbers(link.inertia_kgm2)}"/>'


def _friction(friction: float) -> str:
    return _numbers(np.array([friction, *_OTHER_FRICTION]))


def _numbers(values: Float) -> str:
    return " ".join(repr(float(value)) for value in values)
