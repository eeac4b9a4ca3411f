"""Which decoder reads which message type: a new sensor is one new file and one line here, or a plug-in."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from quadlog.config.plugins import DECODERS, Plugin, find_plugin
from quadlog.errors import DecodeError, UnknownJoints
from quadlog.messages import Int, Message, PointCloud, Pose
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders import foxglove, joints, laser_scan, pose, unitree, uwb
from quadlog.recordings.decoders.columns import Ways
from quadlog.recordings.decoders.fields import ColumnReader
from quadlog.recordings.decoders.joints import JointOrder
from quadlog.recordings.decoders.payload import Payload
from quadlog.recordings.decoders.point_cloud import (
    MakeCloud,
    PointCloud2Decoder,
    Warn,
    checked_cloud,
    cloud_from_block,
    livox_decoder,
)
from quadlog.recordings.decoders.pose_fields import LOST_IF, PoseField, find_pose
from quadlog.recordings.decoders.poses import pose as pose_rows
from quadlog.recordings.decoders.poses import pose_at
from quadlog.recordings.decoders.ros_messages import Definitions, is_defined_as
from quadlog.recordings.decoders.rows import Part, Type
from quadlog.recordings.plugged import MessageDecoder, check_decoder, interpreter, parts_of
from quadlog.recordings.types import FOXGLOVE, PLANAR_SCANS, type_of

Result = TypeVar("Result")

# One payload can hold the ranges of several tags, so a decoder gives a tuple.
Decoder = Callable[[Payload], tuple[Message, ...]]

# Bodies too large for a generic decoder: read by hand. Each Livox driver has its package, and others copy its message:
# matched by the last part of the type, outside of Livox's packages by the definition, too.
POINT_CLOUD, LIVOX, LIVOX_PACKAGES = "sensor_msgs/msg/PointCloud2", "CustomMsg", "livox_"

# Deserialised by definition, then turned into quadlog's own: (message, topic) -> Message.
ROS: dict[str, Callable[[Any, str], Message]] = {
    "geometry_msgs/msg/PoseStamped": pose.decode_pose_stamped,
    "geometry_msgs/msg/PoseWithCovarianceStamped": pose.decode_pose_with_covariance,
    "geometry_msgs/msg/TransformStamped": pose.decode_transform,
    "gtec_msgs/msg/Ranging": uwb.decode_ranging,
    "nav_msgs/msg/Odometry": pose.decode_odometry,
    "sensor_msgs/msg/Imu": pose.decode_imu,
    "sensor_msgs/msg/LaserScan": laser_scan.decode_laser_scan,
    "sensor_msgs/msg/MultiEchoLaserScan": laser_scan.decode_multi_echo_laser_scan,
    "sensor_msgs/msg/Range": uwb.decode_range,
    "tf2_msgs/msg/TFMessage": pose.decode_tf,
    "uwb_driver/msg/UwbRange": uwb.decode_uwb_range,
}

# Many at a time, for types that come often and whose definition usually has a layout.
IN_COLUMNS: dict[str, Ways] = {
    "geometry_msgs/msg/PoseStamped": [(pose.POSE_STAMPED, pose.pose_in_columns)],
    "geometry_msgs/msg/PoseWithCovarianceStamped": [(pose.POSE_WITH_COVARIANCE, pose.pose_in_columns)],
    "geometry_msgs/msg/TransformStamped": [(pose.TRANSFORM_STAMPED, pose.pose_in_columns)],
    "nav_msgs/msg/Odometry": [(pose.ODOMETRY, pose.odometry_in_columns)],
    "sensor_msgs/msg/Imu": [(pose.IMU, pose.imu_in_columns)],
    "tf2_msgs/msg/TFMessage": [(pose.TF, pose.tf_in_columns)],
    "unitree_go/msg/SportModeState": [(unitree.SPORT_MODE_STATE, unitree.sport_mode_states_in_columns)],
}


# The same of types that hold several messages.
SEVERAL: dict[str, Callable[[Any, str], tuple[Message, ...]]] = {
    "unitree_go/msg/SportModeState": unitree.decode_sport_mode_state,
}


class BodyDecoder(NamedTuple):
    """decode: from a message, its topic and the order of joints to messages; ways: the same in columns, of a topic."""

    decode: Callable[[Any, str, JointOrder], tuple[Message, ...]]
    ways: Callable[[str, JointOrder], Ways]


_LOW_STATE = BodyDecoder(unitree.decode_low_state, unitree.low_state_ways)
_HIGH_STATE = BodyDecoder(unitree.decode_high_state, unitree.high_state_ways)

# A quadruped's joints, which the configuration can name too, and what else is in the same message.
BODY: dict[str, BodyDecoder] = {
    "sensor_msgs/msg/JointState": BodyDecoder(joints.decode_joint_state, joints.joint_state_ways),
    "unitree_go/msg/LowState": _LOW_STATE,
    "unitree_legged_msgs/msg/LowState": _LOW_STATE,
    "unitree_legged_msgs/msg/HighState": _HIGH_STATE,
    "ros2_unitree_legged_msgs/msg/LowState": _LOW_STATE,
    "ros2_unitree_legged_msgs/msg/HighState": _HIGH_STATE,
}

# LinkTrack packages have many names: matched by the last part of the type.
LINKTRACK: dict[str, Callable[[Any, str], tuple[Message, ...]]] = {
    "LinktrackAnchorframe0": uwb.decode_anchorframe0,
    "LinktrackNodeframe2": uwb.decode_nodeframe,
    "LinktrackNodeframe3": uwb.decode_nodeframe,
    "LinktrackNodeframe4": uwb.decode_nodeframe4,
    "LinktrackNodeframe5": uwb.decode_nodeframe,
    "LinktrackTagframe0": uwb.decode_tagframe0,
}

FOXGLOVE_PROTOBUF: dict[str, Callable[..., Message]] = {
    "foxglove.PointCloud": foxglove.decode_point_cloud,
    "foxglove.PoseInFrame": foxglove.decode_pose_in_frame,
}

FOXGLOVE_JSON: dict[str, Callable[..., Callable[[Payload], Message]]] = {
    "foxglove.PointCloud": foxglove.json_point_cloud_decoder,
    "foxglove.PoseInFrame": foxglove.json_pose_decoder,
}

# Whose decoders take make_cloud, one of those in decoders/point_cloud.py.
CLOUDS = {POINT_CLOUD, "foxglove.PointCloud"}

LINKTRACK_IN_COLUMNS: dict[str, Ways] = {
    "LinktrackTagframe0": [(wanted, uwb.tagframe0_in_columns) for wanted in (uwb.STAMPED_TAGFRAME0, uwb.TAGFRAME0)],
}

# Types that look as if they held what quadlog wants, and why they do not.
REFUSED = {
    "LinktrackNodeframe0": "carries raw bytes of other nodes, no ranges",
    "LinktrackNodeframe1": "carries solved positions, no ranges",
    "LinktrackNodeframe6": "carries raw bytes of other nodes, no ranges",
}

ENCODINGS = ("ros1", "cdr", "protobuf", "json")


def last_part(type_name: str) -> str:
    """`LinktrackTagframe0` of `any_package/msg/LinktrackTagframe0`."""
    return type_name.rpartition("/")[2]


def is_cloud(type_name: str) -> bool:
    """Whether decoders of a type take make_cloud."""
    return type_name in CLOUDS or last_part(type_name) == LIVOX


def decoder_plugin(type_name: str) -> Plugin | None:
    """The plug-in that decodes a type, None where there is none. Raises QuadlogError."""
    taken = _has_own(type_name) or type_name in FOXGLOVE_PROTOBUF or type_name in FOXGLOVE_JSON
    taken = taken or (is_cloud(type_name) and type_name.startswith(LIVOX_PACKAGES))
    return find_plugin(DECODERS, type_name, taken=taken)


@lru_cache(maxsize=1024)
def plugged_decoder(type_name: str) -> MessageDecoder | None:
    """The decoder of a plug-in for a type, None where there is none. Raises QuadlogError as `find_plugin`."""
    plugin = decoder_plugin(type_name)
    return None if plugin is None else check_decoder(plugin, plugin.load())


def is_decodable(channel: Channel) -> bool:
    """Whether there is a decoder for the channel's type, whatever its payloads turn out to be.

    Raises QuadlogError where a plug-in would be that decoder and cannot.
    """
    name, encoding = channel.type_name, channel.message_encoding
    if plugged_decoder(name) is not None:
        return True
    if encoding == "protobuf":
        return name in FOXGLOVE_PROTOBUF
    if encoding == "json":
        return name in FOXGLOVE_JSON
    if last_part(name) == LIVOX:
        known = name.startswith(LIVOX_PACKAGES)
        return known or is_defined_as("livox_ros_driver2", name, channel.schema_encoding, channel.schema)
    return _has_own(name) or isinstance(found_pose(channel), PoseField)


def _has_own(name: str) -> bool:
    """Whether there is a decoder for ROS messages of this type."""
    return any(name in table for table in (CLOUDS, ROS, SEVERAL, BODY)) or last_part(name) in LINKTRACK


def found_pose(channel: Channel) -> PoseField | str:
    """Where the definition of a type that has no decoder holds a pose, or why it is not taken; empty for all others."""
    name, encoding = channel.type_name, channel.message_encoding
    if _has_own(name) or plugged_decoder(name) is not None or encoding not in ("ros1", "cdr"):
        return ""
    return find_pose(name, encoding, channel.schema_encoding, channel.schema)


def decoder_for(
    channel: Channel,
    definitions: Definitions | None = None,
    order: JointOrder | None = None,
    *,
    points: bool = True,
    warn: Warn = lambda _: None,
) -> Decoder | None:
    """The channel's decoder, or None for a type that quadlog has no use for.

    order: of joints; None: detected. points: False for clouds that are checked but come without points, except those
    of plug-ins. warn: gets what is put right in clouds.
    Raises DecodeError where the type is known but its encoding or its
    definition is not; the decoder raises it for single payloads.
    """
    if not is_decodable(channel):
        return None
    name, topic, encoding = channel.type_name, channel.topic, channel.message_encoding
    if encoding not in ENCODINGS:
        known = ", ".join(ENCODINGS)
        raise DecodeError(topic, f"its message encoding {encoding[:40]!r} is not one quadlog reads ({known})")
    plugged = plugged_decoder(name)
    if plugged is not None:
        return _plugged(channel, plugged, definitions or Definitions())
    of_clouds = {} if points or not is_cloud(name) else {"make_cloud": checked_cloud}
    if encoding == "json":
        return _single(FOXGLOVE_JSON[name](topic, **of_clouds))
    if encoding == "protobuf":
        interpret = partial(FOXGLOVE_PROTOBUF[name], **of_clouds)
        return _single(_chain(foxglove.protobuf_deserialiser(channel), interpret, topic))
    if name == POINT_CLOUD:
        return _single(PointCloud2Decoder(topic, encoding, warn=warn, **of_clouds))
    if last_part(name) == LIVOX:
        return _single(livox_decoder(topic, encoding, **of_clouds))
    definitions = definitions or Definitions()
    if name in ROS:
        return _single(definitions.decoder(channel, ROS[name]))
    if name in BODY:
        decode, joint_order = BODY[name].decode, order or JointOrder()
        return definitions.decoder(channel, lambda message, topic: decode(message, topic, joint_order))
    if name in SEVERAL:
        return definitions.decoder(channel, SEVERAL[name])
    if last_part(name) in LINKTRACK:
        return definitions.decoder(channel, LINKTRACK[last_part(name)])
    found = found_pose(channel)
    assert isinstance(found, PoseField)
    return _single(definitions.decoder(channel, found))


def ways_in_columns(channel: Channel, order: JointOrder | None = None) -> Ways:
    """How the channel's type is decoded many at a time; none where it is not, as static transforms, which are few."""
    if channel.message_encoding not in ("ros1", "cdr") or plugged_decoder(channel.type_name) is not None:
        return ()
    if pose.is_static(channel.topic):
        return ()
    if channel.type_name in BODY:
        return BODY[channel.type_name].ways(channel.topic, order or JointOrder())
    ways = IN_COLUMNS.get(channel.type_name)
    if isinstance(found := found_pose(channel), PoseField):
        return () if found.flag else [(found.wanted, pose.pose_in_columns)]
    return ways if ways is not None else LINKTRACK_IN_COLUMNS.get(last_part(channel.type_name), ())


def _plugged(channel: Channel, decoder: MessageDecoder, definitions: Definitions) -> Decoder:
    """A plug-in's decoder, behind what makes messages of payloads."""
    interpret = interpreter(decoder)
    if channel.message_encoding == "json":
        return _chain(partial(foxglove.json_object, topic=channel.topic), interpret, channel.topic)
    if channel.message_encoding == "protobuf":
        return _chain(foxglove.protobuf_deserialiser(channel), interpret, channel.topic)
    return definitions.decoder(channel, interpret)


def _single(decode: Callable[[Payload], Message]) -> Decoder:
    return lambda payload: (decode(payload),)


def _chain(
    deserialise: Callable[[Payload], Any], interpret: Callable[[Any, str], Result], topic: str
) -> Callable[[Payload], Result]:
    return lambda payload: interpret(deserialise(payload), topic)


class Decoded(NamedTuple):
    """Parts of the payloads with these numbers (N,), of which `failed` could not be decoded; why not the first."""

    which: Int
    parts: Sequence[Part] = ()
    failed: int = 0
    why: str = ""


class RowReader(Protocol):
    """Reads payloads of one channel as rows."""

    def read(self, payloads: Sequence[bytes]) -> Iterator[Decoded]: ...


class CloudReader(NamedTuple):
    """Reads the payloads of one channel as clouds one by one; checked: without points. Both raise DecodeError.

    None for a payload of which a plug-in makes nothing.
    """

    full: Callable[[Payload], PointCloud | None]
    checked: Callable[[Payload], PointCloud | None]


def kinds_of(channel: Channel, mapped: Mapping[str, Type] = {}) -> tuple[type[Message], ...]:
    """What messages of a channel become, the main kind first; none for those that nobody decodes.

    mapped: topic -> the type that the configuration says. Raises QuadlogError where a plug-in cannot be used.
    """
    name, encoding = channel.type_name, channel.message_encoding
    if channel.topic in mapped:
        return mapped[channel.topic].kinds
    plugged = plugged_decoder(name)
    if plugged is not None:
        return (plugged.gives,)
    if encoding in ("protobuf", "json") or name in FOXGLOVE:
        return (FOXGLOVE[name],) if encoding in ("protobuf", "json") and name in FOXGLOVE else ()
    if (own := type_of(name)) is not None:
        return own.kinds
    if _is_ros_cloud(channel):
        return (PointCloud,)
    return (Pose,) if isinstance(found_pose(channel), PoseField) else ()


def _is_ros_cloud(channel: Channel) -> bool:
    name = channel.type_name
    if last_part(name) == LIVOX and not name.startswith(LIVOX_PACKAGES):
        return is_defined_as("livox_ros_driver2", name, channel.schema_encoding, channel.schema)
    return name == POINT_CLOUD or last_part(name) == LIVOX or name in PLANAR_SCANS


def reader_of(
    channel: Channel,
    definitions: Definitions,
    order: JointOrder,
    mapped: Mapping[str, Type] = {},
    warn: Warn = lambda _: None,
) -> RowReader | CloudReader | None:
    """What reads the channel's payloads, None for a type that quadlog has no use for.

    mapped: as for kinds_of; warn: gets what is put right in clouds. Raises DecodeError where the type is known but its
    encoding or its definition is not, and as kinds_of does.
    """
    name, topic, encoding = channel.type_name, channel.topic, channel.message_encoding
    if not kinds_of(channel, mapped):
        return None
    if encoding not in ENCODINGS:
        known = ", ".join(ENCODINGS)
        raise DecodeError(topic, f"its message encoding {encoding[:40]!r} is not one quadlog reads ({known})")
    if topic in mapped:
        return _by_columns(channel, mapped[topic], definitions, order)
    plugged = plugged_decoder(name)
    if plugged is not None:
        decode = _plugged(channel, plugged, definitions)
        return (
            _clouds(lambda _: lambda payload: next(iter(decode(payload)), None))
            if plugged.gives is PointCloud
            else OneByOne(decode)
        )
    if name in FOXGLOVE:
        return _of_foxglove(channel)
    if name == POINT_CLOUD:
        return _clouds(lambda make: PointCloud2Decoder(topic, encoding, make, warn))
    if name in PLANAR_SCANS:
        wanted, cloud_of = PLANAR_SCANS[name]
        columns = ColumnReader(channel, wanted, definitions.candidates)
        return _clouds(lambda _: lambda payload: cloud_of(columns.one(bytes(payload))))
    if last_part(name) == LIVOX:
        return _clouds(partial(livox_decoder, topic, encoding))
    return _by_columns(channel, type_of(name) or _of_found_pose(channel), definitions, order)


def _clouds(make: Callable[[MakeCloud], Callable[[Payload], PointCloud | None]]) -> CloudReader:
    return CloudReader(make(cloud_from_block), make(checked_cloud))


def _of_foxglove(channel: Channel) -> RowReader | CloudReader:
    name, topic = channel.type_name, channel.topic
    if channel.message_encoding == "json":
        if FOXGLOVE[name] is PointCloud:
            return _clouds(partial(foxglove.json_point_cloud_decoder, topic))
        return OneByOne(_single(foxglove.json_pose_decoder(topic)))
    deserialise = foxglove.protobuf_deserialiser(channel)
    if FOXGLOVE[name] is PointCloud:
        return _clouds(lambda make: _chain(deserialise, partial(foxglove.decode_point_cloud, make_cloud=make), topic))
    return OneByOne(_single(_chain(deserialise, foxglove.decode_pose_in_frame, topic)))


def _by_columns(channel: Channel, kind: Type, definitions: Definitions, order: JointOrder) -> RowReader:
    return ByColumns(ColumnReader(channel, kind.wanted, definitions.candidates), kind, order)


def _of_found_pose(channel: Channel) -> Type:
    found = found_pose(channel)
    assert isinstance(found, PoseField)
    wanted = pose_at("", found.header) | {"position": f"{found.position}:xyz", "quat": f"{found.orientation}:xyzw"}
    if not found.flag:
        return Type((Pose,), wanted, pose_rows)
    lost_if = LOST_IF[found.flag.rpartition(".")[2]]
    return Type((Pose,), wanted | {"lost": found.flag}, partial(pose_rows, flag=found.flag, lost_if=lost_if))


class ByColumns:
    """Reads payloads of a type of the table, many at once."""

    def __init__(self, columns: ColumnReader, kind: Type, order: JointOrder) -> None:
        self._columns, self._type, self._order = columns, kind, order

    def read(self, payloads: Sequence[bytes]) -> Iterator[Decoded]:
        """See RowReader."""
        for which, columns in self._columns.read(payloads):
            if isinstance(columns, DecodeError):
                yield Decoded(which, (), len(which), columns.reason)
                continue
            try:
                with np.errstate(all="ignore"):
                    parts = list(self._type.rows(columns, self._order))
            except UnknownJoints:  # of another machine; `detect_roles` reports a topic of nothing else
                yield Decoded(which)
                continue
            except DecodeError as error:
                yield Decoded(which, (), len(which), error.reason)
                continue
            except (ValueError, TypeError, KeyError, IndexError) as error:  # a definition of another shape
                yield Decoded(which, (), len(which), f"not of the usual shape: {error}")
                continue
            stamps, frames, sound = columns.stamp_ns(), columns.frames(), columns.sound
            parts = [each for each in parts if len(each.rows)]
            for i, each in enumerate(parts):
                if each.stamp_ns is None:
                    each = each._replace(stamp_ns=stamps)
                if not sound.all():
                    of = np.arange(columns.n) if each.of is None else each.of
                    each = each._replace(rows=each.rows[sound[of]], of=of[sound[of]])
                parts[i] = each._replace(frames=each.frames or frames)
            yield Decoded(which, parts, int((~sound).sum()), columns.why)


class OneByOne:
    """Reads payloads whose messages are decoded one by one: of plug-ins and Foxglove."""

    def __init__(self, decode: Callable[[Payload], Iterable[Message]]) -> None:
        self._decode = decode

    def read(self, payloads: Sequence[bytes]) -> Iterator[Decoded]:
        """See RowReader."""
        for number, payload in enumerate(payloads):
            which = np.array([number])
            try:
                yield Decoded(which, [part for each in self._decode(payload) for part in parts_of(each)])
            except DecodeError as error:
                yield Decoded(which, (), 1, error.reason)
