"""From a channel to what reads its payloads: rows of small messages, many at a time, or clouds one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, NamedTuple, Protocol

import numpy as np

from quadlog.config.plugins import DECODERS, Plugin, find_plugin
from quadlog.errors import DecodeError, UnknownJoints
from quadlog.messages import Int, Message, PointCloud, Pose
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders import foxglove
from quadlog.recordings.decoders.fields import ColumnReader
from quadlog.recordings.decoders.joints import JointOrder
from quadlog.recordings.decoders.payload import Payload
from quadlog.recordings.decoders.point_cloud import (
    PointCloud2Decoder,
    Warn,
    decode_livox,
)
from quadlog.recordings.decoders.pose_fields import PoseField, find_pose
from quadlog.recordings.decoders.ros_messages import Definitions, is_defined_as
from quadlog.recordings.decoders.rows import Part, Type
from quadlog.recordings.plugged import MessageDecoder, check_decoder, interpreter, parts_of
from quadlog.recordings.types import (
    FOXGLOVE,
    LIVOX,
    LIVOX_PACKAGES,
    PLANAR_SCANS,
    POINT_CLOUD,
    last_part,
    type_of,
)

ENCODINGS = ("ros1", "cdr", "protobuf", "json")


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
    """Reads payloads of one channel as clouds, one by one; checked: without points. Both raise DecodeError.

    None for a payload of which a plug-in makes nothing.
    """

    full: Callable[[Payload], PointCloud | None]
    checked: Callable[[Payload], PointCloud | None]


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
    plugins = {name: decoder_plugin(name) for name in sorted({each.type_name for each in channels if _own_kinds(each)})}
    return [
        f"{name}: decoded by the plug-in of {each.distribution} {each.version}, not by quadlog"
        for name, each in plugins.items()
        if each is not None
    ]


def kinds_of(channel: Channel, mapped: Mapping[str, Type] | None = None) -> tuple[type[Message], ...]:
    """What messages of a channel become, the main kind first; none for those that nobody decodes.

    mapped: topic -> its type by the configuration. Raises QuadlogError where a plug-in cannot be used.
    """
    if mapped and channel.topic in mapped:
        return mapped[channel.topic].kinds
    plugged = plugged_decoder(channel.type_name)
    return _own_kinds(channel) if plugged is None else (plugged.gives,)


def _own_kinds(channel: Channel) -> tuple[type[Message], ...]:
    name, encoding = channel.type_name, channel.message_encoding
    if encoding in ("protobuf", "json") or name in FOXGLOVE:
        return (FOXGLOVE[name],) if encoding in ("protobuf", "json") and name in FOXGLOVE else ()
    if (own := type_of(name)) is not None:
        return own.kinds
    livox = last_part(name) == LIVOX and (
        name.startswith(LIVOX_PACKAGES)
        or is_defined_as("livox_ros_driver2", name, channel.schema_encoding, channel.schema)
    )
    if livox or name == POINT_CLOUD or name in PLANAR_SCANS:
        return (PointCloud,)
    return (Pose,) if isinstance(found_pose(channel), PoseField) else ()


def found_pose(channel: Channel) -> PoseField | str:
    """Where the definition of a type that has no decoder holds a pose, or why it is not taken; empty for all others."""
    name, encoding = channel.type_name, channel.message_encoding
    if type_of(name) or name in PLANAR_SCANS or name == POINT_CLOUD or plugged_decoder(name):
        return ""
    return find_pose(name, encoding, channel.schema_encoding, channel.schema) if encoding in ("ros1", "cdr") else ""


def reader_of(
    channel: Channel,
    definitions: Definitions,
    order: JointOrder,
    mapped: Mapping[str, Type] | None = None,
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
    own = (mapped or {}).get(topic)
    if own is None and (reader := _not_by_columns(channel, definitions, warn)) is not None:
        return reader
    found = own or type_of(name) or found_pose(channel)
    assert not isinstance(found, str)
    kind = found.type() if isinstance(found, PoseField) else found
    return ByColumns(ColumnReader(channel, kind.wanted, definitions.candidates), kind, order)


def _not_by_columns(channel: Channel, definitions: Definitions, warn: Warn) -> RowReader | CloudReader | None:
    """What reads a channel of a plug-in's type, of Foxglove's or of clouds."""
    name, topic, encoding = channel.type_name, channel.topic, channel.message_encoding
    if (plugged := plugged_decoder(name)) is not None:
        return _plugged(channel, plugged, definitions)
    if name in FOXGLOVE:
        if FOXGLOVE[name] is PointCloud:
            return _clouds(partial(foxglove.cloud_decoder, channel))
        pose = foxglove.pose_decoder(channel)
        return OneByOne(lambda payload: [pose(payload)])
    if name == POINT_CLOUD:
        return _clouds(lambda points: PointCloud2Decoder(topic, encoding, points, warn))
    if name in PLANAR_SCANS:
        wanted, cloud_of = PLANAR_SCANS[name]
        columns = ColumnReader(channel, wanted, definitions.candidates)
        return _clouds(lambda points: lambda payload: cloud_of(columns.one(bytes(payload)), points=points))
    if last_part(name) == LIVOX:
        return _clouds(lambda points: partial(decode_livox, topic=topic, encoding=encoding, points=points, warn=warn))
    return None


def _clouds(make: Callable[[bool], Callable[[Payload], PointCloud | None]]) -> CloudReader:
    return CloudReader(make(True), make(False))


def _plugged(channel: Channel, decoder: MessageDecoder, definitions: Definitions) -> RowReader | CloudReader:
    """What reads payloads by a plug-in."""
    interpret = interpreter(decoder)
    message_of: Callable[[Payload], Any]
    if channel.message_encoding == "json":
        message_of = partial(foxglove.json_object, topic=channel.topic)
    elif channel.message_encoding == "protobuf":
        message_of = foxglove.protobuf_deserialiser(channel)
    else:
        message_of = definitions.deserialiser(channel)

    def decode(payload: Payload) -> tuple[Message, ...]:
        return interpret(message_of(payload), channel.topic)

    if decoder.gives is not PointCloud:
        return OneByOne(decode)
    return _clouds(lambda _: lambda payload: next(iter(decode(payload)), None))  # type: ignore[arg-type, return-value]


@dataclass(frozen=True, slots=True)
class ByColumns:
    """Reads payloads of a type of the table, many at once."""

    columns: ColumnReader
    type: Type
    order: JointOrder

    def read(self, payloads: Sequence[bytes]) -> Iterator[Decoded]:
        """See RowReader."""
        for which, columns in self.columns.read(payloads):
            try:
                if isinstance(columns, DecodeError):
                    raise columns
                with np.errstate(all="ignore"):
                    parts = [each for each in self.type.rows(columns, self.order) if len(each.rows)]
            except UnknownJoints as error:  # of another machine; `detect_roles` reports a topic of nothing else
                yield Decoded(which, why=error.reason)
                continue
            except (DecodeError, ValueError, TypeError, KeyError, IndexError) as error:  # a definition of another shape
                why = error.reason if isinstance(error, DecodeError) else str(error)
                yield Decoded(which, (), len(which), why)
                continue
            stamps, frames, sound = columns.stamp_ns(), columns.frames(), columns.sound
            for i, each in enumerate(parts):
                parts[i] = each._replace(frames=each.frames or frames)
                if each.stamp_ns is None:
                    parts[i] = parts[i]._replace(stamp_ns=stamps)
                if not sound.all():
                    of = np.arange(columns.n) if each.of is None else each.of
                    parts[i] = parts[i]._replace(rows=each.rows[sound[of]], of=of[sound[of]])
            yield Decoded(which, parts, int((~sound).sum()), columns.why)


@dataclass(frozen=True, slots=True)
class OneByOne:
    """Reads payloads whose messages are decoded one by one: of plug-ins and Foxglove."""

    decode: Callable[[Payload], Iterable[Message]]

    def read(self, payloads: Sequence[bytes]) -> Iterator[Decoded]:
        """See RowReader."""
        for number, payload in enumerate(payloads):
            try:
                yield Decoded(np.array([number]), [part for each in self.decode(payload) for part in parts_of(each)])
            except DecodeError as error:
                yield Decoded(np.array([number]), (), 1, error.reason)
