"""Read untrusted MJCF and URDF files of robots.

Only what makes a robot is taken over: its bodies, joints, masses, shapes and torque limits. The rest, and whatever
could make MuJoCo allocate without bound or open other files, never reaches it. Meshes and included files must lie in
the folder of the file or below.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

import mujoco

from quadlog.errors import TooLarge, UnreadableFile

Element = ElementTree.Element

MOST_XML_BYTES = 4 << 20
MOST_MESH_BYTES = 64 << 20
# Before pruning; parsing this many takes 0.1 s.
MOST_XML_TAGS = 50_000
# Processing time grows with these counts, in part quadratically.
MOST_PARTS: dict[str, tuple[frozenset[str] | None, int]] = {
    "bodies": (frozenset({"body", "link"}), 200),
    "geoms": (frozenset({"geom", "collision"}), 1000),
    "actuators": (frozenset({"motor", "position", "general", "velocity"}), 200),
    "elements": (None, 5000),
}
_MOST_INCLUDES = 20
_KEPT = {
    "mujoco": {"compiler", "default", "asset", "worldbody", "actuator"},
    "asset": {"mesh"},
    "default": {"default", "joint", "geom", "site", "motor", "position", "general", "velocity", "mesh"},
    "body": {"body", "joint", "freejoint", "geom", "site", "inertial", "frame"},
    "actuator": {"motor", "position", "general", "velocity"},
    "robot": {"link", "joint"},
    "link": {"inertial", "collision"},
}
_KEPT["worldbody"] = _KEPT["frame"] = _KEPT["body"]
_SHAPES = {"sphere", "capsule", "cylinder", "box", "ellipsoid", "mesh", ""}
_IGNORED = ("material", "hfield", "content_type", "meshdir", "assetdir", "texturedir")
"""Attributes that refer to pruned elements."""
_URDF_OPTIONS = '<mujoco><compiler fusestatic="false" discardvisual="true" balanceinertia="true"/></mujoco>'


def read_model(path: Path) -> mujoco.MjSpec:
    """The robot in a file. Raises UnreadableFile, TooLarge."""
    root, meshes = _take_over(path)
    try:
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, "unicode"), assets=meshes)
    except ValueError as error:
        raise UnreadableFile(path, f"MuJoCo cannot load it: {first_line(error)}") from None
    if root.tag == "robot":
        # In URDF a link without inertia weighs nothing; MuJoCo would fill its shapes with water.
        for geom in spec.geoms:
            geom.mass = 0.0
    return spec


def content_digest(path: Path) -> str:
    """SHA-256 of the parts of a robot's file that are used, with its included files and meshes.

    Raises UnreadableFile, TooLarge.
    """
    root, meshes = _take_over(path)
    digest = hashlib.sha256(ElementTree.tostring(root))
    for name, mesh in meshes.items():
        digest.update(f"{name} {len(mesh)} ".encode() + mesh)
    return digest.hexdigest()


def _take_over(path: Path) -> tuple[Element, dict[str, bytes]]:
    """The pruned model, and the content of its meshes by name."""
    root = _parse(path)
    meshes: dict[str, bytes] = {}
    if root.tag == "mujoco":
        _include(root, path, [path.resolve()])
        folder = _mesh_folder(root, path)
        _prune(root, path)
        meshes = _take_meshes(root, path, folder)
    elif root.tag == "robot":
        _prune(root, path)
        for link in root.iter("link"):
            for collision in link.findall("collision"):
                if collision.find("geometry/mesh") is not None:
                    link.remove(collision)
        for joint in root.iter("joint"):
            # The robot gets its one free joint later, at its root.
            joint.set("type", "fixed" if joint.get("type") == "floating" else joint.get("type", ""))
        root.append(ElementTree.fromstring(_URDF_OPTIONS))  # noqa: S314 our own text
    else:
        raise UnreadableFile(path, f"is neither MJCF nor URDF: it begins with <{root.tag}>")
    if any("nan" in value.lower().split() for each in root.iter() for value in each.attrib.values()):
        raise UnreadableFile(path, "contains numbers that are not finite (nan)")
    return root, meshes


@contextmanager
def without_log() -> Iterator[None]:
    """Keep MuJoCo from writing its warnings to MUJOCO_LOG.TXT in the working directory."""
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)


def first_line(error: Exception) -> str:
    """MuJoCo's message, shortened to one line."""
    return " ".join(str(error).split())[:200]


def _parse(path: Path) -> Element:
    try:
        if not path.is_file():
            raise UnreadableFile(path, "no such file")
        with path.open("rb") as file:
            content = file.read(MOST_XML_BYTES + 1)
    except (OSError, ValueError) as error:
        raise UnreadableFile(path, str(error)) from None
    if len(content) > MOST_XML_BYTES:
        raise TooLarge(f"{path}: bytes", max(path.stat().st_size, len(content)), MOST_XML_BYTES)
    try:
        text = content.decode("utf-8-sig")
        # Entities can swell without bound and name files; no robot needs them.
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise UnreadableFile(path, "has a document type or entities, which quadlog does not accept")
        if (tags := text.count("<")) > MOST_XML_TAGS:
            raise TooLarge(f"{path}: XML tags", tags, MOST_XML_TAGS)
        root = ElementTree.fromstring(text.encode())  # noqa: S314 without entities and bounded
    except (UnicodeDecodeError, LookupError, ValueError, ElementTree.ParseError) as error:
        raise UnreadableFile(path, f"is not XML in UTF-8: {first_line(error)}") from None
    if _depth_exceeds(root, 120):
        raise UnreadableFile(path, "is nested too deeply")
    return root


def _depth_exceeds(root: Element, most: int) -> bool:
    level = [root]
    for _ in range(most):
        level = [child for each in level for child in each]
        if not level:
            return False
    return True


def _include(root: Element, path: Path, seen: list[Path]) -> None:
    """Insert the content of included files; as in MuJoCo, paths are relative to the main file's folder."""
    waiting = [root]
    while waiting:
        parent = waiting.pop()
        for place in range(len(parent) - 1, -1, -1):
            child = parent[place]
            if child.tag != "include":
                waiting.append(child)
                continue
            file = _inside(path, path.parent / child.get("file", ""))
            if file in seen or len(seen) > _MOST_INCLUDES:
                raise UnreadableFile(path, f"includes {file.name} twice, or more than {_MOST_INCLUDES} files")
            seen.append(file)
            parent[place : place + 1] = list(_parse(file))
            waiting += [parent]
            break


def _inside(path: Path, file: Path) -> Path:
    """The resolved path of a file that `path` refers to. Raises UnreadableFile outside of path's folder."""
    try:
        real, folder = file.resolve(), path.parent.resolve()
        if real.is_relative_to(folder) and real.is_file():
            return real
        reason = "is not there" if real.is_relative_to(folder) else "lies outside of the model's folder"
    except (OSError, ValueError, RuntimeError):
        reason = "cannot be opened"
    raise UnreadableFile(path, f"names the file {file.name[:80]!r}, which {reason}")


def _mesh_folder(root: Element, path: Path) -> Path:
    folder = path.parent
    for compiler in root.iter("compiler"):
        named = compiler.get("meshdir", compiler.get("assetdir"))
        folder = path.parent / named if named is not None else folder
    return folder


def _prune(root: Element, path: Path) -> None:
    """Remove everything but the robot's parts. Raises TooLarge where there are more of them than MOST_PARTS."""
    waiting = [root]
    while waiting:
        parent = waiting.pop()
        for name in _IGNORED:
            parent.attrib.pop(name, None)
        if parent.tag not in _KEPT:
            if root.tag == "mujoco":
                parent[:] = []
            continue
        kept = [child for child in parent if child.tag in _KEPT[parent.tag]]
        parent[:] = [child for child in kept if child.tag != "geom" or child.get("type", "") in _SHAPES]
        waiting += list(parent)
    for name, (tags, most) in MOST_PARTS.items():
        count = sum(1 for each in root.iter() if tags is None or each.tag in tags)
        if count > most:
            raise TooLarge(f"{path}: {name}", count, most)


def _take_meshes(root: Element, path: Path, folder: Path) -> dict[str, bytes]:
    """The content of the meshes' files, by the names that they get in `root`."""
    meshes: dict[str, bytes] = {}
    left = MOST_MESH_BYTES
    for number, mesh in enumerate(root.iter("mesh")):
        named = mesh.attrib.pop("file", None)
        if named is None:
            continue
        file = _inside(path, folder / named)
        mesh.set("name", mesh.get("name", Path(named).stem))
        left -= file.stat().st_size
        if left < 0:
            raise TooLarge(f"{path}: bytes of meshes", MOST_MESH_BYTES - left, MOST_MESH_BYTES)
        key = f"mesh_{number}{file.suffix.lower()}"
        mesh.set("file", key)
        meshes[key] = file.read_bytes()
    return meshes


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
