"""From a channel to what reads its payloads: rows of small messages, many at a time, or clouds one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from quadlog.errors import DecodeError, UnknownJoints
from quadlog.messages import Int, Message, PointCloud
from quadlog.plugins import DECODERS, Plugin, find_plugin
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders import foxglove
from quadlog.recordings.decoders.fields import ColumnReader
from quadlog.recordings.decoders.joints import JointOrder
from quadlog.recordings.decoders.payload import Payload
from quadlog.recordings.decoders.pose_fields import FoundPose, find_pose
from quadlog.recordings.decoders.ros_messages import Definitions, is_defined_as
from quadlog.recordings.decoders.rows import Clouds, Part, Type, Warn
from quadlog.recordings.plugged import MessageDecoder, check_decoder, interpreter
from quadlog.recordings.types import LIVOX, LIVOX_PACKAGES, TYPES, last_part

ROS, OBJECTS = ("ros1", "cdr"), ("protobuf", "json")
"""Encodings of messages."""


class Decoded(NamedTuple):
    """Parts of the payloads with these numbers (N,), of which `failed` could not be decoded; why not the first."""

    which: Int
    parts: Sequence[Part] = ()
    failed: int = 0
    why: str = ""


class RowReader(NamedTuple):
    """Reads payloads of one channel as rows, many at once, in any order."""

    read: Callable[[Sequence[bytes]], Iterator[Decoded]]


class CloudReader(NamedTuple):
    """Reads payloads of one channel as clouds, one by one.

    decode: called with a payload and whether points are wanted; None where a plug-in makes nothing of it. Raises
    DecodeError.
    """

    decode: Callable[[Payload, bool], PointCloud | None]


def decoder_plugin(type_name: str) -> Plugin | None:
    """The plug-in that decodes a type, also one of quadlog's own; None where there is none. Raises QuadlogError."""
    return find_plugin(DECODERS, type_name, taken=False)


@lru_cache(maxsize=1024)
def plugged_decoder(type_name: str) -> MessageDecoder | None:
    """The decoder of a plug-in for a type, None where there is none. Raises QuadlogError."""
    plugin = decoder_plugin(type_name)
    return None if plugin is None else check_decoder(plugin, plugin.load())


def plugin_notes(channels: Iterable[Channel]) -> list[str]:
    """One line for each type of quadlog's own that a plug-in decodes instead."""
    plugins = {name: decoder_plugin(name) for name in sorted({each.type_name for each in channels if _own_way(each)})}
    return [
        f"{name}: decoded by the plug-in of {each.distribution} {each.version}, not by quadlog"
        for name, each in plugins.items()
        if each is not None
    ]


def way_of(channel: Channel, mapped: Mapping[str, Type] | None = None) -> Type | Clouds | MessageDecoder | None:
    """How a channel's payloads are decoded, None where nobody decodes them.

    mapped: topic -> its type by the configuration. Raises QuadlogError where a plug-in cannot be used.
    """
    if mapped and channel.topic in mapped:
        return mapped[channel.topic]
    return plugged_decoder(channel.type_name) or _own_way(channel)


def kinds_of(channel: Channel, mapped: Mapping[str, Type] | None = None) -> tuple[type[Message], ...]:
    """What messages of a channel become, the main kind first; none for those that nobody decodes. See way_of."""
    way = way_of(channel, mapped)
    return () if way is None else way.kinds if isinstance(way, Type) else (way.gives,)


def _own_way(channel: Channel) -> Type | Clouds | MessageDecoder | None:
    """The row of the table, or the pose that a definition holds."""
    found = _row_of(channel)
    if found is None and isinstance(pose := found_pose(channel), FoundPose):
        return pose.type
    return found


def _row_of(channel: Channel) -> Type | Clouds | MessageDecoder | None:
    name, last = channel.type_name, last_part(channel.type_name)
    row = TYPES.get(name) or TYPES.get(last)
    if last == LIVOX and not name.startswith(LIVOX_PACKAGES):
        copied = is_defined_as("livox_ros_driver2", name, channel.schema_encoding, channel.schema)
        row = row if copied else None
    return row if isinstance(row, MessageDecoder) == (channel.message_encoding in OBJECTS) else None


def found_pose(channel: Channel) -> FoundPose | str:
    """Where the definition of a type that has no decoder holds a pose, or why it is not taken; empty for all others."""
    name, encoding = channel.type_name, channel.message_encoding
    if encoding not in ROS or _row_of(channel) or plugged_decoder(name):
        return ""
    return find_pose(name, encoding, channel.schema_encoding, channel.schema)


def reader_of(
    channel: Channel,
    definitions: Definitions,
    order: JointOrder,
    mapped: Mapping[str, Type] | None = None,
    warn: Warn = lambda _: None,
) -> RowReader | CloudReader | None:
    """What reads the channel's payloads, None for a type that quadlog has no use for.

    mapped: as for way_of; warn: gets what is put right in clouds. Raises DecodeError where the type is known but its
    encoding or its definition is not, and as way_of does.
    """
    way = way_of(channel, mapped)
    if way is None:
        return None
    if channel.message_encoding not in ROS + OBJECTS:
        known, given = ", ".join(ROS + OBJECTS), channel.message_encoding[:40]
        raise DecodeError(channel.topic, f"its message encoding {given!r} is not one quadlog reads ({known})")
    if isinstance(way, Type):
        columns = ColumnReader(channel, way.wanted, definitions.candidates)
        return RowReader(partial(_by_columns, columns, way, order))
    if isinstance(way, Clouds):
        return CloudReader(way.decoder(channel, definitions, warn))
    decode = _message_decoder(channel, way, definitions)
    if way.gives is PointCloud:
        return CloudReader(lambda payload, _: next(iter(decode(payload)), None))
    return RowReader(partial(_one_by_one, decode))


def _message_decoder(
    channel: Channel, decoder: MessageDecoder, definitions: Definitions
) -> Callable[[Payload], list[Any]]:
    """What decodes payloads by their messages as objects: of plug-ins, and of Foxglove."""
    own, topic = TYPES.get(channel.type_name) is decoder, channel.topic
    interpret = interpreter(decoder, f"not a {channel.type_name}" if own else "its plug-in failed")
    message_of: Callable[[Payload], Any]
    if channel.message_encoding == "json":
        message_of = partial(foxglove.json_object, topic=topic, object_of=_namespace if own else dict)
    elif channel.message_encoding == "protobuf":
        message_of = foxglove.protobuf_deserialiser(channel)
    else:
        message_of = definitions.deserialiser(channel)
    return lambda payload: interpret(message_of(payload), topic)


def _namespace(fields: Mapping[str, object]) -> SimpleNamespace:
    return SimpleNamespace(**fields)


def _by_columns(reader: ColumnReader, kind: Type, order: JointOrder, payloads: Sequence[bytes]) -> Iterator[Decoded]:
    """Payloads of a type of the table, many at once."""
    for which, columns in reader.read(payloads):
        try:
            if isinstance(columns, DecodeError):
                raise columns
            with np.errstate(all="ignore"):
                parts = [each for each in kind.rows(columns, order) if len(each.rows)]
        except UnknownJoints as error:  # of another machine; `detect_roles` reports a topic of nothing else
            yield Decoded(which, why=error.reason)
            continue
        except (DecodeError, ValueError, TypeError, KeyError, IndexError) as error:  # a definition of another shape
            why = error.reason if isinstance(error, DecodeError) else str(error)
            yield Decoded(which, (), len(which), why)
            continue
        stamps, frames, sound = columns.stamp_ns(), columns.frames(), columns.sound
        for i, each in enumerate(parts):
            stamp_ns = stamps if each.stamp_ns is None else each.stamp_ns
            parts[i] = each._replace(frames=each.frames or frames, stamp_ns=stamp_ns)
            if not sound.all():
                of = np.arange(columns.n) if each.of is None else each.of
                parts[i] = parts[i]._replace(rows=each.rows[sound[of]], of=of[sound[of]])
        yield Decoded(which, parts, int((~sound).sum()), columns.why)


def _one_by_one(decode: Callable[[Payload], Sequence[Part]], payloads: Sequence[bytes]) -> Iterator[Decoded]:
    """Payloads that are decoded by their messages."""
    for number, payload in enumerate(payloads):
        try:
            yield Decoded(np.array([number]), decode(payload))
        except DecodeError as error:
            yield Decoded(np.array([number]), (), 1, error.reason)
