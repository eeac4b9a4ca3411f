"""Load a user's robot model and adapt its joints, motors and contacts to quadlog's conventions.

Its masses, inertias, limits and shapes stay its own. Joints that turn the other way round are turned; its motors give
way to torque motors within the same limits; only its feet and trunk touch the ground.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from quadlog.control.locomotion.kinematics import foot_positions
from quadlog.control.locomotion.robot import JOINTS, LEGS, Robot
from quadlog.errors import UnusableRobot
from quadlog.messages import Float
from quadlog.simulation.robot.height_field import FRICTION, HeightField
from quadlog.simulation.robot.model import TIMESTEP_S, QuadrupedModel, add_world, describe, fill_heights
from quadlog.simulation.robot.model_files import compiled, limits_nm, read_model, without_log

_OFF_M = 0.005
"""Robots of this kind have their feet a few millimetres off the leg's plane."""
_STANDING = 0.62
"""Hip height of a standing robot, as a share of the straight leg's length; the file does not give it."""
_LIKE_OURS = (
    "x forward, y left, z up; four equal legs at the corners of a rectangle; joints about x, y and y; "
    "straight down with all joints at 0"
)


def measured_robot(model: mujoco.MjModel, path: Path, torque_limit_nm: float, foot_radius_m: float) -> Robot:
    """The robot's dimensions and masses. Raises UnusableRobot where its legs are of another kind."""
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
            raise UnusableRobot(path, f"legs like quadlog's (a foot is {off.max() * 1e3:.0f} mm off): {_LIKE_OURS}")
    for name, angle in zip(joints, robot.standing_joints_rad, strict=True):
        data.joint(name).qpos[0] = angle
    mujoco.mj_forward(model, data)
    full = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    centre = data.subtree_com[model.body("trunk").id].copy()
    moved = full[0, 0] * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return replace(robot, measured=(centre, full[3:6, 3:6] - moved))


PREFIXES = {
    "left_fore": ("left_fore", "left_front", "fore_left", "front_left", "fl", "lf"),
    "right_fore": ("right_fore", "right_front", "fore_right", "front_right", "fr", "rf"),
    "left_hind": ("left_hind", "left_rear", "hind_left", "rear_left", "rl", "lh", "hl"),
    "right_hind": ("right_hind", "right_rear", "hind_right", "rear_right", "rr", "rh", "hr"),
}
_FOOT_RADIUS_M, _ARMATURE_KGM2 = 0.02, 0.01


@dataclass(frozen=True)
class _Foot:
    """Where a leg ends: a point (3,) of a body."""

    body: Any
    place_m: Float
    radius_m: float


@without_log()
def load_user_model(path: Path, ground: HeightField, friction: float = FRICTION) -> QuadrupedModel:
    """The world with the robot of an MJCF or URDF file.

    Legs are found by the beginning of their joints' names, see PREFIXES; joints along a leg by their order.
    Raises UnreadableFile, TooLarge, UnusableRobot.
    """
    spec = read_model(path)
    limits = limits_nm(spec)
    joints, feet, root = _find(spec, path)
    missing = [joint.name for joint in joints if joint.name not in limits]
    if missing:
        raise UnusableRobot(
            path, f"a torque limit of {missing[0]}: URDF effort, actuatorfrcrange or an actuator's forcerange"
        )
    torque_nm = np.array([limits[joint.name] for joint in joints])
    _clear(spec, root)
    _name(spec, joints, root, torque_nm)
    for foot, leg in zip(feet, LEGS, strict=True):
        foot.body.add_site(name=f"{leg}_foot", pos=foot.place_m)
    _turn_joints(compiled(spec, path), spec)
    _add_contacts(joints, feet, root, friction)
    add_world(spec, ground, friction, TIMESTEP_S)
    # MuJoCo weighs a contact by its body, and a foot fixed to a shank is to count as the shank. Not before the last
    # compilation: it takes the foot's body out of `spec`.
    spec.compiler.fusestatic = True
    model = compiled(spec, path)
    robot = measured_robot(model, path, float(torque_nm.min()), feet[0].radius_m)
    fill_heights(model, ground)
    return describe(model, robot, ground)


def _leg_of(name: str) -> str | None:
    short = name.rsplit("/", 1)[-1].lower().lstrip("0123456789_")
    for leg, prefixes in PREFIXES.items():
        if any(short == prefix or short.startswith((f"{prefix}_", f"{prefix}-", f"{prefix}.")) for prefix in prefixes):
            return leg
    return None


def _find(spec: mujoco.MjSpec, path: Path) -> tuple[list[Any], list[_Foot], Any]:
    """The twelve joints, the four feet and the body that everything hangs on. Raises UnusableRobot."""
    needed, joints, feet, roots = [], [], [], set()
    free = mujoco.mjtJoint.mjJNT_FREE
    for leg in LEGS:
        hinges = [joint for joint in spec.joints if _leg_of(joint.name) == leg and joint.type != free]
        hinges.sort(key=lambda joint: len(_ancestors(joint.parent)))
        along = [joint for joint in hinges if joint.type == mujoco.mjtJoint.mjJNT_HINGE]
        chain = _ancestors(along[-1].parent) if along else []
        if len(hinges) != 3 or len(along) != 3 or len({body.name for body in chain if body.joints}) < 3:
            found = ", ".join(joint.name for joint in hinges) or "none"
            needed.append(f"three hinge joints one below the other named {_hint(leg)}_... (found {found})")
            continue
        joints += along
        roots.add(chain[-1].name)
        foot = _foot(leg, along[-1].parent)
        if foot is None:
            needed.append(f"a foot: a site, sphere or body below {along[-1].name} with foot in its name")
        else:
            feet.append(foot)
    others = [joint.name or "unnamed" for joint in spec.joints if _leg_of(joint.name) is None and joint.type != free]
    if others:
        needed.append(f"no other joints (found {', '.join(others[:5])})")
    if not needed and len(roots) != 1:
        needed.append("one body that all legs hang on")
    if needed:
        raise UnusableRobot(path, "; ".join(needed))
    return joints, feet, _ancestors(joints[0].parent)[-1]


def _hint(leg: str) -> str:
    return f"{leg} or {PREFIXES[leg][-2].upper()}"


def _ancestors(body: Any) -> list[Any]:
    """The body and those it hangs on, the world left out."""
    chain = []
    while body is not None and body.name != "world":
        chain.append(body)
        body = body.parent
    return chain


def _foot(leg: str, shank: Any) -> _Foot | None:
    bodies = [shank, *shank.find_all("body")]

    def is_foot(name: str) -> bool:
        short = name.rsplit("/", 1)[-1].lower()
        return _leg_of(name) == leg and (any(word in short for word in ("foot", "toe")) or short in PREFIXES[leg])

    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    places: list[_Foot] = []
    for body in bodies:
        own = is_foot(body.name)
        for geom in body.geoms:
            if geom.type == sphere and (own or is_foot(geom.name)):
                places.append(_Foot(body, np.array(geom.pos), float(geom.size[0])))
    for body in bodies:
        places += [_Foot(body, np.array(site.pos), _FOOT_RADIUS_M) for site in body.sites if is_foot(site.name)]
    places += [_Foot(body, np.zeros(3), _FOOT_RADIUS_M) for body in bodies if is_foot(body.name)]
    return places[0] if places else None


def _clear(spec: mujoco.MjSpec, root: Any) -> None:
    """Remove motors and surroundings, disable all collisions, and add a free joint where there is none."""
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for body in list(spec.worldbody.bodies):
        if body.name != root.name:
            spec.delete(body)
    for geom in list(spec.worldbody.geoms):
        spec.delete(geom)
    for kind in (spec.geoms, spec.sites):
        for number, each in enumerate(kind):
            each.name = f"user_{number}"
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    free = [joint for joint in root.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    if not free:
        root.add_freejoint()
    root.pos, root.quat = [0, 0, 0], [1, 0, 0, 0]


def _name(spec: mujoco.MjSpec, joints: list[Any], root: Any, torque_nm: Float) -> None:
    """Name the joints and the trunk as quadlog does, and add a torque motor to each joint."""
    for number, body in enumerate(spec.bodies[1:]):
        body.name = f"user_{number}"
    root.name = "trunk"
    # First make all names unique: a new name may be in use for another joint.
    for number, joint in enumerate(spec.joints):
        joint.name = f"user_{number}"
    names = [f"{leg}_{kind}" for leg in LEGS for kind in JOINTS]
    for joint, name, limit_nm in zip(joints, names, torque_nm.tolist(), strict=True):
        joint.name, joint.ref = name, 0.0
        joint.armature = joint.armature if np.any(np.asarray(joint.armature) > 0) else _ARMATURE_KGM2
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        motor.ctrllimited = motor.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        motor.ctrlrange = motor.forcerange = [-limit_nm, limit_nm]


def _turn_joints(model: mujoco.MjModel, spec: mujoco.MjSpec) -> None:
    """Give each joint quadlog's sense of rotation: abduction about x, hip and knee about -y."""
    data = mujoco.MjData(model)
    data.qpos[:] = 0
    data.qpos[3] = 1
    mujoco.mj_kinematics(model, data)
    for leg in LEGS:
        for kind, along in zip(JOINTS, ((1, 0, 0), (0, -1, 0), (0, -1, 0)), strict=True):
            joint = spec.joint(f"{leg}_{kind}")
            if data.joint(joint.name).xaxis @ np.array(along) < 0:
                joint.axis = -np.array(joint.axis)
                low, high = joint.range
                joint.range, joint.springref = [-high, -low], -joint.springref


def _add_contacts(joints: list[Any], feet: list[_Foot], root: Any, friction: float) -> None:
    touch = {"contype": 0, "conaffinity": 1, "condim": 3, "friction": [friction, 0.005, 0.0001], "mass": 0.0}
    for foot, leg in zip(feet, LEGS, strict=True):
        ball = mujoco.mjtGeom.mjGEOM_SPHERE
        foot.body.add_geom(name=f"{leg}_foot", type=ball, size=[foot.radius_m, 0, 0], pos=foot.place_m, **touch)
    shapes = [geom for geom in root.geoms if geom.type != mujoco.mjtGeom.mjGEOM_MESH]
    for geom in shapes:
        geom.conaffinity, geom.condim, geom.friction = 1, 3, touch["friction"]
    if not shapes:
        # Without a shape, a box that reaches to the hips.
        hip_m = np.abs([joint.parent.pos for joint in joints[::3]]).max(axis=0)
        size = np.maximum([0.1, 0.05, 0.05], hip_m * [1, 1, 0])
        root.add_geom(name="trunk", type=mujoco.mjtGeom.mjGEOM_BOX, size=size, **touch)
