"""Types that quadlog does not read: why, and which key, driver or plug-in makes their topics usable."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import NamedTuple

from quadlog.messages import Imu, JointStates, Message, Odometry, PointCloud, Pose, Transforms, Twist, UwbRanges
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.fields import leaves_of
from quadlog.recordings.decoders.pose_fields import HEADER_TYPE
from quadlog.recordings.decoders.ros_messages import embedded_types, standard_types
from quadlog.recordings.decoders.rows import Type
from quadlog.recordings.decoders.type_definitions import BadDefinition
from quadlog.recordings.decoding import kinds_of
from quadlog.recordings.topics.topic_names import name_words
from quadlog.recordings.types import REFUSED, last_part

NEAREST_ROLE: dict[type[Message], str] = {
    PointCloud: "lidar",
    UwbRanges: "uwb",
    Odometry: "odometry",
    Twist: "command",
    Imu: "imu",
    Pose: "reference",
    Transforms: "tf",
    JointStates: "joints",
}


class Unread(NamedTuple):
    """Types whose name, `package/Name`, a pattern finds. role: the one that they look fit for, or none.

    why: they are not read; do: what to do about that, empty where nothing is lost by it.
    """

    pattern: str
    role: str
    why: str
    do: str = ""

    @property
    def words(self) -> str:
        """Why a topic that looks fit for a role is not."""
        return "; ".join(filter(None, [self.why, self.do])) if self.role else f"not used: {self.why}"


def _packets(packages: str, driver: str) -> Unread:
    do = f"let the lidar's driver ({driver}) turn them into PointCloud2 and record that"
    return Unread(
        rf"^({packages})/.*(Packet|Scan)", "lidar", "holds driver packets ({type}), which are not point clouds", do
    )


REPUBLISH = "record what  ros2 run point_cloud_transport republish  makes of it (out_transport raw)"
TABLE = (
    _packets("velodyne_msgs", "velodyne_pointcloud"),
    _packets("ouster_(msgs|ros|sensor_msgs)", "ouster_ros"),
    _packets("robosense_msgs|rslidar_msgs?", "rslidar_sdk"),
    _packets("pandar_msgs|hesai_ros_driver", "hesai_ros_driver"),
    _packets("nebula_msgs", "nebula_ros"),
    _packets("innovusion_msgs|seyond_msgs", "seyond_ros_driver"),
    _packets(r"livox_\w+", "livox_ros_driver2"),
    Unread("Compressed.*PointCloud|DracoPointCloud", "lidar", "holds compressed clouds ({type})", REPUBLISH),
    Unread("^sensor_msgs/PointCloud$", "lidar", "is the old PointCloud", "record PointCloud2 (point_cloud_converter)"),
    Unread("Image|CameraInfo|CompressedVideo|Theora", "", "quadlog reads no camera images"),
    Unread("/Sentence$|GPSFix|NavPVT|BestPos", "", "of satellites quadlog reads NavSatFix", "record NavSatFix"),
    Unread("NavSat|Gps|GPS", "", "of satellites quadlog reads NavSatFix"),
    Unread("Log|Diagnostic|Rosout|ParameterEvent", "", "quadlog reads no logs and diagnostics"),
    Unread("Twist|Cmd|Command|Joy", "", "quadlog reads no commands"),
    Unread("Path|OccupancyGrid|GridMap|Marker|Map", "", "quadlog reads no results of other programs"),
)
"""The first row that fits counts."""
PLUGIN = "a plug-in reads types of your own: see howto/plugins in the documentation"


def unread(channel: Channel, mapped: Mapping[str, Type] = {}) -> Unread | None:
    """The row of a channel whose messages are not read, None where they are. mapped: as for kinds_of."""
    if kinds_of(channel, mapped):
        return None
    last = last_part(channel.type_name)
    name = f"{channel.type_name.partition('/')[0]}/{last}"
    rows = [Unread("", "uwb", REFUSED[last])] if last in REFUSED else TABLE
    why = f"quadlog has no decoder for {last or 'messages without a type'}"
    row = next((row for row in rows if re.search(row.pattern, name)), Unread("", "", why, PLUGIN))
    return row._replace(why=row.why.replace("{type}", channel.type_name))


def nearest_role(channel: Channel, mapped: Mapping[str, Type] = {}) -> str | None:
    """The role that a topic looks fit for, usable or not."""
    row = unread(channel, mapped)
    return NEAREST_ROLE[kinds_of(channel, mapped)[0]] if row is None else row.role or None


def hint(channel: Channel, mapped: Mapping[str, Type] = {}) -> str:
    """What makes a topic without a role usable: keys of quadlog.toml, a driver, a plug-in; empty where nothing does."""
    if channel.type_name == "sensor_msgs/msg/Range" and channel.topic not in mapped:
        return _table("uwb.range_topics", channel, tag="0", anchor="1")
    row = unread(channel, mapped)
    if row is None or row.do is not PLUGIN:
        return "" if row is None else row.do
    if channel.message_encoding not in ("ros1", "cdr") or standard_types(channel.message_encoding, channel.type_name):
        return ""
    paths = _numbers(channel)
    return _ranges(channel, paths) or _pose(channel, paths) or PLUGIN


def _table(key: str, channel: Channel, **values: str) -> str:
    lines = [f"[[{key}]]", f"topic = {json.dumps(channel.topic)}", *(f"{name} = {values[name]}" for name in values)]
    return "\n".join(lines)


RANGE_WORDS = {"range", "ranges", "dist", "dis", "distance", "distances"}
TAG_WORDS = {"tag", "initiator", "requester", "source", "src", "from", "sender"}
ID_WORDS = {"id", "ids", "address", "addr", "anchor", "responder", "destination", "dest", "dst", "to", "node", "peer"}
NO_RANGE = {"min", "max", "minimum", "maximum", "limit", "std", "stddev", "sigma", "variance", "error", "bias", "num"}
"""In names of fields about ranges that hold none."""


def _ranges(channel: Channel, paths: dict[str, str]) -> str:
    """The keys for a message with a distance and ids, by the names of its fields."""
    distances = [path for path in paths if _words(path) & RANGE_WORDS and not _words(path) & ID_WORDS]
    distances = [path for path in distances if not name_words(path.rpartition(".")[2]) & NO_RANGE]
    if not distances:
        return ""
    place = distances[0].rpartition(".")[0]
    ids = [path for path in paths if "float" not in paths[path] and _words(path) & (ID_WORDS | TAG_WORDS)]
    tags = [path for path in ids if _words(path) & TAG_WORDS and "[]" not in path]
    anchors = [path for path in ids if path not in tags and path.rpartition(".")[0] == place]
    if not anchors:
        return ""
    tags += [path for path in ids if path not in anchors[:1] and "[]" not in path]
    tag = json.dumps(tags[0]) if tags else "0"
    field, anchor, unit = json.dumps(distances[0]), json.dumps(anchors[0]), _unit(distances[0])
    return _table("uwb.range_topics", channel, tag=tag, anchor=anchor, field=field, unit=unit)


NO_PLACE = {"vel", "velocity", "speed", "rate", "angular", "twist", "acc", "accel", "acceleration", "gyro", "force"}
NO_PLACE |= {"torque", "field", "mag", "std", "covariance", "size", "scale", "euler", "linear"}
TURN_WORDS = {"q", "quat", "quaternion", "rot", "rotation", "orientation", "attitude"}
AXIS = re.compile(r"(?:^|[._])([pqr]?)([xyzw])(?:$|[._])")


def _pose(channel: Channel, paths: dict[str, str]) -> str:
    """The keys for a message with a position, or a position and a quaternion, by the names of its fields."""
    place, turn = dict[str, str](), dict[str, str]()
    for path in (path for path in paths if "[]" not in path and not _words(path) & NO_PLACE):
        axis = AXIS.search(re.sub(r"(?<=[a-z])(?=[A-Z])", "_", path).lower())
        if axis is not None:
            turned = axis[1] in ("q", "r") or axis[2] == "w" or _words(path) & TURN_WORDS
            (turn if turned else place).setdefault(axis[2], path)
    if len(place) < 3:
        return ""
    fields = [place[axis] for axis in "xyz"] + ([turn[axis] for axis in "xyzw"] if len(turn) == 4 else [])
    return _table("topics.poses", channel, fields=json.dumps(fields), unit=_unit(fields[0]))


def _words(path: str) -> set[str]:
    return name_words(path.rpartition(".")[2]) | name_words(path.rpartition(".")[0].rpartition(".")[2])


def _unit(path: str) -> str:
    """As the field's name says; else metres, with what else it may be as a comment."""
    unit = next((f'"{unit}"' for unit in ("mm", "cm") if unit in name_words(path)), "")
    return unit or '"m"  # or "mm", "cm"'


def _numbers(channel: Channel) -> dict[str, str]:
    """Path and type of each number in messages of a type by its definition; `[]` in a path: of each element."""
    try:
        leaves = list(leaves_of(embedded_types(*channel.identity[1:]), channel.type_name, but=HEADER_TYPE))
    except BadDefinition:
        return {}
    return {path: base for path, base, _ in leaves if base not in ("string", "wstring", "bool")}
