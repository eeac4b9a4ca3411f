"""Poses in messages of unknown types, such as those of motion capture: found by the definition in the recording.

A type counts where it has a std_msgs/Header and exactly one pose, directly or in a field one level down: a Pose, a
PoseWithCovariance, a Transform, or a Point beside a Quaternion, all of geometry_msgs. Names of fields do not matter.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache, partial
from typing import NamedTuple

from rosbags.interfaces import Nodetype

from quadlog.messages import Pose
from quadlog.recordings.decoders.poses import pose, pose_at
from quadlog.recordings.decoders.ros_messages import standard_types
from quadlog.recordings.decoders.rows import Type
from quadlog.recordings.decoders.type_definitions import ARRAYS, BadDefinition, Types, needed_types, parse_definition

HEADER_TYPE = "std_msgs/msg/Header"
POINT, QUATERNION = "geometry_msgs/msg/Point", "geometry_msgs/msg/Quaternion"
WHOLE_POSES = {
    "geometry_msgs/msg/Pose": ("position", "orientation"),
    "geometry_msgs/msg/PoseWithCovariance": ("pose.position", "pose.orientation"),
    "geometry_msgs/msg/Transform": ("translation", "rotation"),
}
# A text without these cannot define such a type; parsing takes a millisecond a line.
_SIGNS = (b"Pose", b"Transform", b"Quaternion")
LOST_IF = {"occluded": True, "tracking_valid": False}
"""Flags by which trackers say that a pose was not measured, and their values then; it is then old, or zero."""
MOST_NAMED = 3


class FoundPose(NamedTuple):
    """name: the field, or the two fields, in which a user would look for the pose. type: how messages are read."""

    name: str
    type: Type


@lru_cache(maxsize=1024)
def find_pose(type_name: str, message_encoding: str, schema_encoding: str, schema: bytes) -> FoundPose | str:
    """The one pose of a type by its definition, or why it is not taken; empty where it holds none, or is standard."""
    if not (b"Header" in schema or b"Stamped" in schema) or not any(sign in schema for sign in _SIGNS):
        return ""
    if standard_types(message_encoding, type_name):
        return ""  # as a marker, a map or a path, which are known to be no pose of a robot

    try:
        types = parse_definition(schema, type_name, schema_encoding or "ros2msg")
        return _find(needed_types(types, type_name, partial(standard_types, message_encoding)), type_name)
    except BadDefinition:
        return ""


def _find(types: Types, type_name: str) -> FoundPose | str:
    """types: as needed_types gives them."""
    found = list(_poses(types, type_name))
    below = [(name, inner) for name, inner in _structures(types, type_name) if inner != HEADER_TYPE]
    if not found:
        found = [each for name, inner in below for each in _poses(types, inner, f"{name}.")]
    headers = [name for name, inner in _structures(types, type_name) if inner == HEADER_TYPE]
    if not headers and len(found) == 1:
        parent = found[0][2].partition(".")[0]
        headers = [
            f"{parent}.{name}" for name, inner in _structures(types, dict(below)[parent]) if inner == HEADER_TYPE
        ]
    if not headers:
        return ""
    if len(found) == 1:
        position, orientation, name = found[0]
        wanted = pose_at("", headers[0]) | {"position": f"{position}:xyz", "quat": f"{orientation}:xyzw"}
        if flag := _flag(types, type_name, name.rpartition(".")[0]):
            rows = partial(pose, flag=flag, lost_if=LOST_IF[flag.rpartition(".")[2]])
            return FoundPose(name, Type((Pose,), wanted | {"lost": flag}, rows))
        return FoundPose(name, Type((Pose,), wanted, pose))
    if found:
        names = ", ".join(name for *_, name in found[:MOST_NAMED])
        return f"holds {len(found)} poses ({names}), and it is unknown which is the robot's"
    arrays = [
        name
        for name, inner in _structures(types, type_name, arrays=True)
        if inner in WHOLE_POSES or any(_poses(types, inner))
    ]
    if arrays:
        return f"holds arrays of poses ({', '.join(arrays[:MOST_NAMED])}); record the pose of one body on its own topic"
    return ""


def _flag(types: Types, type_name: str, parent: str) -> str:
    """Path of a flag beside the pose, which lies in the field `parent`, or of one at the top; empty for none."""
    inside = dict(_structures(types, type_name)).get(parent)
    inner = [] if inside is None else [f"{parent}.{name}" for name, _ in types[inside][1]]
    flags = [path for path in (*inner, *(name for name, _ in types[type_name][1])) if path.split(".")[-1] in LOST_IF]
    return flags[0] if flags else ""


def _structures(types: Types, type_name: str, arrays: bool = False) -> list[tuple[str, str]]:
    """Fields that are messages, or arrays of messages, and the types of these."""
    fields = [(name, each) for name, each in types[type_name][1] if (each[0] in ARRAYS) == arrays]
    several = [(name, detail[0] if arrays else (kind, detail)) for name, (kind, detail) in fields]
    return [(name, detail) for name, (kind, detail) in several if kind == Nodetype.NAME]


def _poses(types: Types, type_name: str, prefix: str = "") -> Iterator[tuple[str, str, str]]:
    """Paths of position and orientation, and the name for users, of each pose among the fields of a type."""
    structures = _structures(types, type_name)
    for name, inner in structures:
        if inner in WHOLE_POSES:
            position, orientation = WHOLE_POSES[inner]
            yield f"{prefix}{name}.{position}", f"{prefix}{name}.{orientation}", prefix + name
    points = [prefix + name for name, inner in structures if inner == POINT]
    turns = [prefix + name for name, inner in structures if inner == QUATERNION]
    if len(points) == len(turns) == 1:
        yield points[0], turns[0], f"{points[0]} and {turns[0]}"
