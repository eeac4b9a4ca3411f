"""Types that quadlog does not read: why, and which key, driver or plug-in makes their topics usable."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
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
    paths = _values(channel)
    return _ranges(channel, paths) or _pose(channel, paths) or PLUGIN


def _table(key: str, channel: Channel, remark: str = "", **values: str) -> str:
    values = {"topic": json.dumps(channel.topic)} | values
    return "\n".join([f"[[{key}]]{remark and '  # '}{remark}", *(f"{name} = {values[name]}" for name in values)])


RANGE_WORDS = {"range", "ranges", "dist", "dis", "distance", "distances"}
TAG_WORDS = {"tag", "initiator", "requester", "source", "src", "from", "sender"}
ID_WORDS = {"id", "ids", "address", "addr", "anchor", "responder", "destination", "dest", "dst", "to", "node", "peer"}
NO_RANGE = {"min", "max", "minimum", "maximum", "limit", "std", "stddev", "sigma", "variance", "error", "bias", "num"}
NO_ID = {"frame", "seq", "msg", "message", "packet"}
"""In names of fields about ranges that hold none, and of ids of other things."""


def _ranges(channel: Channel, paths: dict[str, str]) -> str:
    """The keys for a message with a distance or times of ranging, and ids, by the names of its fields."""
    numbers = [path for path in paths if "string" not in paths[path]]
    distances = [path for path in numbers if _words(path) & RANGE_WORDS and not _words(path) & ID_WORDS]
    distances = [path for path in distances if not name_words(path.rpartition(".")[2]) & NO_RANGE]
    times = [] if distances else _times([path for path in numbers if "int" in paths[path]])
    if not distances and not times:
        return ""
    place = (distances or times)[0].rpartition(".")[0]
    ids = [path for path in paths if "float" not in paths[path] and _words(path) & (ID_WORDS | TAG_WORDS)]
    ids = [path for path in ids if path not in times and not name_words(path.rpartition(".")[2]) & NO_ID]
    tags = [path for path in ids if _words(path) & TAG_WORDS and "[]" not in path]
    anchors = [path for path in ids if path not in tags and path.rpartition(".")[0] == place]
    if not anchors:
        return ""
    tags += [path for path in ids if path not in anchors[:1] and "[]" not in path]
    tag = json.dumps(tags[0]) if tags else "0"
    ends = {"tag": tag, "anchor": json.dumps(anchors[0])}
    if times:
        return _table("uwb.range_topics", channel, **ends, times=json.dumps(times), tick_s=TICK_S)
    return _table("uwb.range_topics", channel, **ends, field=json.dumps(distances[0]), unit=_unit(distances[0]))


TICK_S = "1.565e-11  # of DW1000 and DW3000; what the times count, in seconds"
STEPS, SIDES = (("poll",), ("resp", "repl"), ("fin",)), (("tx", "sen"), ("rx", "rec"))
"""Of double-sided two-way ranging: parts of the names of its messages; sent and received."""


def _times(paths: Sequence[str]) -> list[str]:
    """Six times or four intervals of double-sided two-way ranging, in the order of the keys, by their names."""
    names = {path: path.rpartition(".")[2].lower() for path in paths}

    def named(*parts: Sequence[str]) -> list[str]:
        return [path for path in paths if all(any(each in names[path] for each in some) for some in parts)]

    six, rounds, replies = [named(step, side) for step in STEPS for side in SIDES], named(["round"]), named(["repl"])
    if all(len(each) == 1 for each in six):
        return [each[0] for each in six]
    if len(rounds) == len(replies) == 2:  # which reply is whose does not matter
        return [rounds[0], replies[0], rounds[1], replies[1]]
    numbered = sorted((path for path in paths if re.fullmatch("t_?[1-6]", names[path])), key=lambda path: names[path])
    return numbered if len(numbered) == 6 else []


NO_PLACE = {"vel", "velocity", "speed", "rate", "angular", "twist", "acc", "accel", "acceleration", "gyro", "force"}
NO_PLACE |= {"variance", "torque", "field", "mag", "std", "covariance", "size", "scale", "euler", "linear"}
PLACE_WORDS = {"position", "pos", "place", "location", "translation", "xyz", "point", "p"}
TURN_WORDS = {"q", "quat", "quaternion", "rot", "rotation", "orientation", "attitude"}
AXIS = re.compile(r"(?:^|[._])([pqr]?)([xyzw])(?:$|[._])")


def _pose(channel: Channel, paths: dict[str, str]) -> str:
    """The keys for a message with a position, or a position and a quaternion, by the names of its fields."""
    place, turn = dict[str, str](), dict[str, str]()
    for path, name in _named_axes(paths):
        axis = AXIS.search(re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower())
        if axis is not None:
            turned = axis[1] in ("q", "r") or axis[2] == "w" or _words(name) & TURN_WORDS
            (turn if turned else place).setdefault(axis[2], path)
    if len(place) < 3:
        return ""
    fields = [place[axis] for axis in "xyz"] + ([turn[axis] for axis in "xyzw"] if len(turn) == 4 else [])
    remark = "if the array of the orientation begins with w" if fields[-1].endswith("[0]") else ""
    if channel.type_name.startswith("px4_msgs/"):
        fields = [f"{'-' * (i in (1, 2, 4, 5))}{path}" for i, path in enumerate(fields)]
        remark = "north, west, up"
    return _table("topics.poses", channel, remark, fields=json.dumps(fields), unit=_unit(place["x"]))


def _named_axes(paths: dict[str, str]) -> Iterator[tuple[str, str]]:
    """Paths of numbers, those in fixed arrays of a place or a turn one by one, and paths that name their axes."""
    for path in (path for path in paths if not _words(path) & NO_PLACE):
        array, axes = path.removesuffix("[]"), {"[3]": "xyz", "[4]": "wxyz"}.get(paths[path][-3:], "")
        if "[]" not in path:
            yield path, path
        elif "[]" not in array and _words(array) & (PLACE_WORDS if axes == "xyz" else TURN_WORDS):
            yield from ((f"{array}[{i}]", f"{array}.{axis}") for i, axis in enumerate(axes))


def _words(path: str) -> set[str]:
    return name_words(path.rpartition(".")[2]) | name_words(path.rpartition(".")[0].rpartition(".")[2])


def _unit(path: str) -> str:
    """As the field's name says; else metres, with what else it may be as a comment."""
    unit = next((f'"{unit}"' for unit in ("mm", "cm") if unit in name_words(path)), "")
    return unit or '"m"  # or "mm", "cm"'


def _values(channel: Channel) -> dict[str, str]:
    """Path and type of each number and text in messages of a type by its definition.

    `[]` in a path: of each element; a type with `[3]`: of a fixed array.
    """
    try:
        leaves = list(leaves_of(embedded_types(*channel.identity[1:]), channel.type_name, but=HEADER_TYPE))
    except BadDefinition:
        return {}
    return {path: base + f"[{size}]" * bool(size) for path, base, size in leaves if base not in ("wstring", "bool")}
