"""What a compiled model's robot is, in quadlog's numbers: measured where it stands, not taken from its file."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from quadlog.errors import UnusableRobot
from quadlog.locomotion.kinematics import foot_positions
from quadlog.locomotion.robot import JOINTS, LEGS, Robot

_OFF_M = 0.005
"""Robots of this kind have their feet a few millimetres off the leg's plane."""
_STANDING = 0.62
"""Of the straight leg's length: how high the hips of a robot stand that nobody has told."""
_LIKE_OURS = (
    "x forward, y left, z up; four equal legs at the corners of a rectangle; joints about x, y and y; "
    "straight down with all joints at 0"
)


def measured_robot(model: mujoco.MjModel, path: Path, torque_limit_nm: float, foot_radius_m: float) -> Robot:
    """The robot that this model is. Raises UnusableRobot where its legs are not quadlog's."""
    data = mujoco.MjData(model)
    joints = [f"{leg}_{kind}" for leg in LEGS for kind in JOINTS]
    data.qpos[:] = 0
    data.qpos[3] = 1
    mujoco.mj_kinematics(model, data)
    hips = np.array([data.joint(f"{leg}_abduction").xanchor for leg in LEGS])
    foot, knee, hip = (
        data.site("left_fore_foot").xpos,
        *(data.joint(f"left_fore_{k}").xanchor for k in ("knee", "hip")),
    )
    lengths = (abs(float(foot[1] - hips[0, 1])), float(np.linalg.norm(knee - hip)), float(np.linalg.norm(foot - knee)))
    middle = hips.mean(axis=0)
    masses = [float(model.body_subtreemass[model.joint(f"left_fore_{kind}").bodyid[0]]) for kind in JOINTS]
    links = (masses[0] - masses[1], masses[1] - masses[2], masses[2], 0.0)
    forward, aside = (float(np.abs(hips - middle)[:, axis].mean()) for axis in (0, 1))
    height_m = _STANDING * (lengths[1] + lengths[2]) + foot_radius_m - float(middle[2])
    robot = Robot(
        name=path.stem,
        trunk_mass_kg=float(model.body_subtreemass[model.body("trunk").id]) - 4 * masses[0],
        trunk_m=(2 * forward, 2 * aside, 0.1),
        hip_x_m=forward,
        hip_y_m=aside,
        lengths_m=lengths,
        link_masses_kg=links,
        torque_limit_nm=torque_limit_nm,
        standing_height_m=height_m,
        foot_radius_m=foot_radius_m,
        armature_kgm2=float(model.dof_armature[model.joint("left_fore_hip").dofadr[0]]),
        hip_centre_m=(float(middle[0]), float(middle[1]), float(middle[2])),
    )
    feet, rng = np.empty((4, 3)), np.random.default_rng(0)
    for spread in (0.0, 0.4, 0.4):
        angles = rng.uniform(-spread, spread, 12)
        for name, angle in zip(joints, angles, strict=True):
            data.joint(name).qpos[0] = angle
        mujoco.mj_kinematics(model, data)
        foot_positions(angles, robot.hips_m, robot.lengths, feet)
        off = np.linalg.norm(feet - [data.site(f"{leg}_foot").xpos for leg in LEGS], axis=1)
        if not off.max() < _OFF_M:
            raise UnusableRobot(path, [f"legs like quadlog's (a foot is {off.max() * 1e3:.0f} mm off): {_LIKE_OURS}"])
    return _with_inertia(robot, model, data)


def _with_inertia(robot: Robot, model: mujoco.MjModel, data: mujoco.MjData) -> Robot:
    """The robot with its centre of mass and inertia, standing, as its own links have them."""
    angles = iter(robot.standing_joints_rad)
    for leg in LEGS:
        for kind in JOINTS:
            data.joint(f"{leg}_{kind}").qpos[0] = next(angles)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    bodies = np.flatnonzero(model.body_rootid == model.body("trunk").id)
    weights = model.body_mass[bodies]
    centre = weights @ data.xipos[bodies] / weights.sum()
    inertia = np.zeros((3, 3))
    for body, weight in zip(bodies, weights, strict=True):
        axes, arm = data.ximat[body].reshape(3, 3), data.xipos[body] - centre
        inertia += axes @ np.diag(model.body_inertia[body]) @ axes.T
        inertia += weight * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return robot.with_inertia(centre, inertia)
