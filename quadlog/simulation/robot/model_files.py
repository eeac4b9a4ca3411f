"""Read MJCF and URDF files of robots with MuJoCo.

Only what makes a robot is taken over: its bodies, joints, masses, shapes and torque limits.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

import mujoco
import numpy as np

from quadlog.errors import TooLarge, UnreadableFile

MOST_XML_BYTES = 4 << 20
_NAN = re.compile(r"""=\s*["'](?:[^"']*\s)?nan(?:\s[^"']*)?["']""", re.IGNORECASE)
_URDF_OPTIONS = '<mujoco><compiler fusestatic="false" discardvisual="true" balanceinertia="true"/></mujoco>'
_BESIDE = (
    "cameras", "lights", "keys", "sensors", "tendons", "equalities", "excludes", "pairs", "plugins", "skins", "flexes",
    "hfields", "materials", "textures", "numerics", "texts", "tuples",
)  # fmt: skip
_SHAPES = {
    getattr(mujoco.mjtGeom, f"mjGEOM_{name}") for name in ("SPHERE", "CAPSULE", "CYLINDER", "BOX", "ELLIPSOID", "MESH")
}


@contextmanager
def without_log() -> Iterator[None]:
    """Keep MuJoCo from writing its warnings to MUJOCO_LOG.TXT in the working directory."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def read_model(path: Path) -> mujoco.MjSpec:
    """The robot in a file. Raises UnreadableFile, TooLarge."""
    try:
        if not path.is_file():
            raise UnreadableFile(path, "no such file")
        if (size := path.stat().st_size) > MOST_XML_BYTES:
            raise TooLarge(f"{path}: bytes", size, MOST_XML_BYTES)
        text = path.read_text(encoding="utf-8-sig")
        if _NAN.search(text):
            raise UnreadableFile(path, "contains numbers that are not finite (nan)")
        is_urdf = "</robot>" in text
        if is_urdf:
            spec = mujoco.MjSpec.from_string(text.replace("</robot>", f"{_URDF_OPTIONS}</robot>"))
        else:
            spec = mujoco.MjSpec.from_file(str(path))
    except (OSError, ValueError) as error:
        raise UnreadableFile(path, f"MuJoCo cannot load it: {_first_line(error)}") from None
    if is_urdf:
        _as_mjcf(spec)
    _keep_robot(spec)
    return spec


def _as_mjcf(spec: mujoco.MjSpec) -> None:
    """What URDF has otherwise: no joint but those of legs, no meshes of packages, shapes that weigh nothing."""
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:  # The robot gets its one free joint later, at its root.
            spec.delete(joint)
    for geom in list(spec.geoms):
        # A link without inertia weighs nothing; MuJoCo would fill its shapes with water.
        geom.mass = 0.0
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)


def _keep_robot(spec: mujoco.MjSpec) -> None:
    for geom in list(spec.geoms):
        geom.material = ""
        if geom.type not in _SHAPES:
            spec.delete(geom)
    for site in spec.sites:
        site.material = ""
    others = [each for each in spec.actuators if each.trntype != mujoco.mjtTrn.mjTRN_JOINT]
    for each in chain(others, *(list(getattr(spec, kind)) for kind in _BESIDE)):
        spec.delete(each)
    spec.option = mujoco.MjSpec().option


@without_log()
def content_digest(path: Path) -> str:
    """SHA-256 of the model that a robot's file makes, with its included files and meshes.

    Raises UnreadableFile, TooLarge.
    """
    model = compiled(read_model(path), path)
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return hashlib.sha256(content.tobytes()).hexdigest()


def compiled(spec: mujoco.MjSpec, path: Path) -> mujoco.MjModel:
    """The model of a specification that came from a file. Raises UnreadableFile."""
    try:
        return spec.compile()
    except ValueError as error:
        raise UnreadableFile(path, f"MuJoCo cannot load it: {_first_line(error)}") from None


def _first_line(error: Exception) -> str:
    """MuJoCo's message, shortened to one line."""
    return " ".join(str(error).split())[:200]


def limits_nm(spec: mujoco.MjSpec) -> dict[str, float]:
    """Each joint's torque limit, by its name, where the file gives one."""
    limits: dict[str, float] = {}
    for joint in spec.joints:
        low, high = joint.actfrcrange
        if high > low:
            limits[joint.name] = float(min(-low, high))
    for actuator in spec.actuators:
        gear = float(actuator.gear[0])
        ranges = [(actuator.forcerange, gear)]
        if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE and actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED:
            # A motor's control is a torque as well.
            ranges.append((actuator.ctrlrange, gear * float(actuator.gainprm[0])))
        for bounds, gain in ranges:
            if bounds[1] > bounds[0]:
                limit = float(min(-bounds[0], bounds[1])) * abs(gain)
                limits[actuator.target] = min(limit, limits.get(actuator.target, limit))
    return {name: limit for name, limit in limits.items() if limit > 0}
