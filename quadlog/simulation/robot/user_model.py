"""Load a user's robot model and adapt its joints, motors and contacts to quadlog's conventions.

Its masses, inertias, limits and shapes stay its own. Joints that turn the other way round are turned; its motors give
way to torque motors within the same limits; only its feet and trunk touch the ground.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from quadlog.control.locomotion.kinematics import foot_positions
from quadlog.control.locomotion.robot import LEGS, Robot
from quadlog.errors import UnusableRobot
from quadlog.messages import Float
from quadlog.simulation.robot import model as models
from quadlog.simulation.robot.height_field import FRICTION, HeightField
from quadlog.simulation.robot.model_files import compiled, limits_nm, read_model, without_log

_OFF_M = 0.005
"""Robots of this kind have their feet a few millimetres off the leg's plane."""
_STANDING = 0.62
"""Hip height of a standing robot, as a share of the straight leg's length; the file does not give it."""
_LIKE_OURS = (
    "x forward, y left, z up; four equal legs at the corners of a rectangle; joints about x, y and y; "
    "straight down with all joints at 0"
)
PREFIXES = {
    "left_fore": ("left_fore", "left_front", "fore_left", "front_left", "fl", "lf"),
    "right_fore": ("right_fore", "right_front", "fore_right", "front_right", "fr", "rf"),
    "left_hind": ("left_hind", "left_rear", "hind_left", "rear_left", "rl", "lh", "hl"),
    "right_hind": ("right_hind", "right_rear", "hind_right", "rear_right", "rr", "rh", "hr"),
}
_FOOT_RADIUS_M = 0.02

Foot = tuple[Any, Float, float]
"""Where a leg ends: a body, a place (3,) of it, and a radius in metres."""


def measured_robot(model: mujoco.MjModel, path: Path, torque_limit_nm: float, foot_radius_m: float) -> Robot:
    """The robot's dimensions and masses. Raises UnusableRobot where its legs are of another kind."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    hips = np.array([data.joint(f"{leg}_abduction").xanchor for leg in LEGS])
    hip, knee = (data.joint(f"left_fore_{kind}").xanchor for kind in ("hip", "knee"))
    foot, middle = data.site("left_fore_foot").xpos, hips.mean(axis=0)
    lengths = (abs(float(foot[1] - hips[0, 1])), float(np.linalg.norm(knee - hip)), float(np.linalg.norm(foot - knee)))
    forward, aside, _ = np.abs(hips - middle).mean(axis=0).tolist()
    robot = Robot(
        name=path.stem,
        trunk_mass_kg=float(model.body_subtreemass[0]),
        trunk_m=(2 * forward, 2 * aside, 0.1),
        hip_x_m=forward,
        hip_y_m=aside,
        lengths_m=lengths,
        link_masses_kg=(0.0, 0.0, 0.0, 0.0),
        torque_limit_nm=torque_limit_nm,
        standing_height_m=_STANDING * (lengths[1] + lengths[2]) + foot_radius_m - float(middle[2]),
        foot_radius_m=foot_radius_m,
        hip_centre_m=(float(middle[0]), float(middle[1]), float(middle[2])),
    )
    feet, rng = np.empty((4, 3)), np.random.default_rng(0)
    for spread in (0.0, 0.4, 0.4):
        angles = rng.uniform(-spread, spread, 12)
        for name, angle in zip(models.JOINT_NAMES, angles, strict=True):
            data.joint(name).qpos[0] = angle
        mujoco.mj_kinematics(model, data)
        foot_positions(angles, robot.hips_m, robot.lengths, feet)
        off = np.linalg.norm(feet - [data.site(f"{leg}_foot").xpos for leg in LEGS], axis=1)
        if not off.max() < _OFF_M:
            raise UnusableRobot(path, f"legs like quadlog's (a foot is {off.max() * 1e3:.0f} mm off): {_LIKE_OURS}")
    return robot


@without_log()
def load_user_model(path: Path, ground: HeightField, friction: float = FRICTION) -> models.QuadrupedModel:
    """The world with the robot of an MJCF or URDF file.

    Legs are found by the beginning of their joints' names, see PREFIXES; joints along a leg by their order.
    Raises UnreadableFile, TooLarge, UnusableRobot.
    """
    spec = read_model(path)
    limits = limits_nm(spec)
    joints, feet, root = _find(spec, path)
    for joint in joints:
        if joint.name not in limits:
            needed = f"a torque limit of {joint.name}: URDF effort, actuatorfrcrange or an actuator's forcerange"
            raise UnusableRobot(path, needed)
    torque_nm = [limits[joint.name] for joint in joints]
    _clear(spec, root)
    _name(spec, joints, root)
    for (body, place_m, radius_m), leg in zip(feet, LEGS, strict=True):
        models.add_foot(body, leg, place_m, radius_m, friction)
    _turn_joints(compiled(spec, path), joints)
    _touch(joints, root, models.touching(friction))
    models.add_motors(spec, torque_nm)
    models.add_world(spec, ground, friction, models.TIMESTEP_S)
    # MuJoCo weighs a contact by its body, and a foot fixed to a shank is to count as the shank. Not before the last
    # compilation: it takes the foot's body out of `spec`.
    spec.compiler.fusestatic = True
    model = compiled(spec, path)
    return models.describe(model, measured_robot(model, path, min(torque_nm), feet[0][2]), ground)


def _leg_of(name: str) -> str | None:
    short = name.rsplit("/", 1)[-1].lower().lstrip("0123456789_")
    for leg, prefixes in PREFIXES.items():
        if any(short == prefix or short.startswith((f"{prefix}_", f"{prefix}-", f"{prefix}.")) for prefix in prefixes):
            return leg
    return None


def _find(spec: mujoco.MjSpec, path: Path) -> tuple[list[Any], list[Foot], Any]:
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
            hint = f"{leg} or {PREFIXES[leg][-2].upper()}"
            needed.append(f"three hinge joints one below the other named {hint}_... (found {found})")
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


def _ancestors(body: Any) -> list[Any]:
    """The body and those it hangs on, the world left out."""
    chain = []
    while body is not None and body.name != "world":
        chain.append(body)
        body = body.parent
    return chain


def _foot(leg: str, shank: Any) -> Foot | None:
    bodies = [shank, *shank.find_all("body")]

    def is_foot(name: str) -> bool:
        short = name.rsplit("/", 1)[-1].lower()
        return _leg_of(name) == leg and (any(word in short for word in ("foot", "toe")) or short in PREFIXES[leg])

    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    places: list[Foot] = []
    for body in bodies:
        own = is_foot(body.name)
        for geom in body.geoms:
            if geom.type == sphere and (own or is_foot(geom.name)):
                places.append((body, np.array(geom.pos), float(geom.size[0])))
    for body in bodies:
        places += [(body, np.array(site.pos), _FOOT_RADIUS_M) for site in body.sites if is_foot(site.name)]
    places += [(body, np.zeros(3), _FOOT_RADIUS_M) for body in bodies if is_foot(body.name)]
    return places[0] if places else None


def _clear(spec: mujoco.MjSpec, root: Any) -> None:
    """Remove motors and surroundings, disable all collisions, and add a free joint where there is none."""
    others = [body for body in spec.worldbody.bodies if body.name != root.name]
    for each in (*list(spec.actuators), *others, *list(spec.worldbody.geoms)):
        spec.delete(each)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    if not any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in root.joints):
        root.add_freejoint()
    root.pos, root.quat = [0, 0, 0], [1, 0, 0, 0]


def _name(spec: mujoco.MjSpec, joints: list[Any], root: Any) -> None:
    """Name the joints and the trunk as quadlog does; the joints' positions begin at 0, and rotors weigh something."""
    for kind in (spec.geoms, spec.sites, spec.bodies[1:], spec.joints):
        # First make all names unique: a new name may be in use for another joint.
        for number, each in enumerate(kind):
            each.name = f"user_{number}"
    root.name = "trunk"
    for joint, name in zip(joints, models.JOINT_NAMES, strict=True):
        joint.name, joint.ref = name, 0.0
        joint.armature = joint.armature if np.any(np.asarray(joint.armature) > 0) else models.ARMATURE_KGM2


def _turn_joints(model: mujoco.MjModel, joints: list[Any]) -> None:
    """Give each joint quadlog's sense of rotation: abduction about x, hip and knee about -y."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for joint, along in zip(joints, models.AXES * 4, strict=True):
        if data.joint(joint.name).xaxis @ np.array(along) < 0:
            joint.axis = -np.array(joint.axis)
            low, high = joint.range
            joint.range, joint.springref = [-high, -low], -joint.springref


def _touch(joints: list[Any], root: Any, touching: dict[str, Any]) -> None:
    """Let the trunk's shapes touch the ground; without one, a box that reaches to the hips."""
    shapes = [geom for geom in root.geoms if geom.type != mujoco.mjtGeom.mjGEOM_MESH]
    for geom in shapes:
        for name in ("conaffinity", "condim", "friction"):
            setattr(geom, name, touching[name])
    if not shapes:
        hip_m = np.abs([joint.parent.pos for joint in joints[::3]]).max(axis=0)
        size = np.maximum([0.1, 0.05, 0.05], hip_m * [1, 1, 0])
        root.add_geom(name="trunk", type=mujoco.mjtGeom.mjGEOM_BOX, size=size, mass=0.0, **touching)
