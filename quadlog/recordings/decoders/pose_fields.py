"""Poses in messages of unknown types, such as those of motion capture: found by the definition in the recording.

A type counts where it has a std_msgs/Header and exactly one pose, directly or in a field one level down: a Pose, a
PoseWithCovariance, a Transform, or a Point beside a Quaternion, all of geometry_msgs. Names of fields do not matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache, partial
from typing import NamedTuple

from rosbags.interfaces import Nodetype

from quadlog.messages import Pose
from quadlog.recordings.decoders.poses import pose, pose_at
from quadlog.recordings.decoders.ros_messages import embedded_types, standard_types
from quadlog.recordings.decoders.rows import Type
from quadlog.recordings.decoders.type_definitions import ARRAYS, BadDefinition, Types

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
        return _find(embedded_types(type_name, message_encoding, schema_encoding, schema), type_name)
    except BadDefinition:
        return ""


def _find(types: Types, type_name: str) -> FoundPose | str:
    """types: as needed_types gives them."""
    top = _messages(types, type_name)
    inner = {name: _messages(types, kind) for name, kind in top.items() if kind != HEADER_TYPE}
    below = {f"{name}.{field}": kind for name, fields in inner.items() for field, kind in fields.items()}
    found = _poses(top) or _poses(below)
    headers = [name for name, kind in top.items() if kind == HEADER_TYPE]
    if not headers and len(found) == 1:
        parent = found[0][2].partition(".")[0]
        headers = [f"{parent}.{name}" for name, kind in inner[parent].items() if kind == HEADER_TYPE]
    if not headers:
        return ""
    if len(found) > 1:
        names = ", ".join(name for *_, name in found[:MOST_NAMED])
        return f"holds {len(found)} poses ({names}), and it is unknown which is the robot's"
    if not found:
        arrays = _messages(types, type_name, arrays=True)
        several = [name for name, kind in arrays.items() if kind in WHOLE_POSES or _poses(_messages(types, kind))]
        listed, do = ", ".join(several[:MOST_NAMED]), "record the pose of one body on its own topic"
        return f"holds arrays of poses ({listed}); {do}" if several else ""
    position, orientation, name = found[0]
    wanted = pose_at("", headers[0]) | {"position": f"{position}:xyz", "quat": f"{orientation}:xyzw"}
    # Beside the pose, or at the top.
    kind, parent = top.get(name.rpartition(".")[0], ""), name.rpartition(".")[0]
    beside = [f"{parent}.{field}" for field, _ in types[kind][1]] if kind else []
    flags = [each for each in (*beside, *dict(types[type_name][1])) if each.split(".")[-1] in LOST_IF]
    if not flags:
        return FoundPose(name, Type((Pose,), wanted, pose))
    rows = partial(pose, flag=flags[0], lost_if=LOST_IF[flags[0].rpartition(".")[2]])
    return FoundPose(name, Type((Pose,), wanted | {"lost": flags[0]}, rows))


def _messages(types: Types, type_name: str, arrays: bool = False) -> dict[str, str]:
    """Fields that are messages, or arrays of messages, and the types of these."""
    fields = [(name, each) for name, each in types[type_name][1] if (each[0] in ARRAYS) == arrays]
    several = [(name, detail[0] if arrays else (kind, detail)) for name, (kind, detail) in fields]
    return {name: detail for name, (kind, detail) in several if kind == Nodetype.NAME}


def _poses(messages: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """Paths of position and orientation, and the name for users, of each pose among fields that are messages."""
    found = []
    for parent in dict.fromkeys(name.rpartition(".")[0] for name in messages):
        mine = {name: kind for name, kind in messages.items() if name.rpartition(".")[0] == parent}
        whole = [(name, *WHOLE_POSES[kind]) for name, kind in mine.items() if kind in WHOLE_POSES]
        found += [(f"{name}.{position}", f"{name}.{orientation}", name) for name, position, orientation in whole]
        points, turns = ([name for name in mine if mine[name] == kind] for kind in (POINT, QUATERNION))
        if len(points) == len(turns) == 1:
            found.append((points[0], turns[0], f"{points[0]} and {turns[0]}"))
    return found
