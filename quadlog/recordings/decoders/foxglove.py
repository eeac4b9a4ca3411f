"""Foxglove's own PointCloud and PoseInFrame, as protobuf or JSON."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from quadlog.errors import DecodeError
from quadlog.geometry import FARTHEST_M, apply_transform, transform_from_quat
from quadlog.messages import NS_PER_S, Float, PointCloud, Pose
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.payload import Payload, frame_name
from quadlog.recordings.decoders.point_cloud import Block, Column, check_block, cloud_from_block
from quadlog.recordings.decoders.rows import unit_rows
from quadlog.recordings.decoders.type_definitions import LARGEST_DEFINITION_BYTES

# foxglove.PackedElementField numeric types, in their order from 1.
NUMERIC_TYPES = ("u1", "i1", "<u2", "<i2", "<u4", "<i4", "<f4", "<f8")
NUMERIC_NAMES = ("UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64")


def cloud_decoder(channel: Channel, points: bool = True) -> Callable[[Payload], PointCloud]:
    """Decodes foxglove.PointCloud as protobuf or JSON; its pose, the origin in frame_id, is applied to the points."""

    def cloud(message: Any) -> PointCloud:
        layout = {}
        for each in message.fields:
            kind = NUMERIC_NAMES.index(each.type) + 1 if isinstance(each.type, str) else int(each.type)
            if 1 <= kind <= len(NUMERIC_TYPES) and each.offset >= 0:
                layout[each.name] = Column(int(each.offset), np.dtype(NUMERIC_TYPES[kind - 1]))
        data, stride, frame = message.data, int(message.point_stride), frame_name(message.frame_id)
        data = base64.b64decode(data, validate=True) if isinstance(data, str) else data
        if not data:
            return PointCloud(_stamp_ns(message), frame, np.empty((0, 3), np.float32))
        if stride <= 0 or len(data) % stride:
            raise DecodeError(channel.topic, f"{len(data)} bytes of points are no multiple of point_stride {stride}")
        block = Block(data, 0, 1, len(data) // stride, len(data), stride)
        check_block(channel.topic, block, len(data), layout)
        made = cloud_from_block(channel.topic, block, layout, _stamp_ns(message), frame, points)
        if not getattr(message, "pose", None):
            return made
        position_m, quat_xyzw = _pose(message.pose, channel.topic)
        if not position_m.any() and abs(quat_xyzw[3]) == 1:
            return made
        xyz_m = apply_transform(transform_from_quat(position_m, quat_xyzw), made.xyz_m).astype(np.float32)
        return replace(made, xyz_m=xyz_m)

    return _decoder(channel, cloud)


def pose_decoder(channel: Channel) -> Callable[[Payload], Pose]:
    """Decodes foxglove.PoseInFrame as protobuf or JSON."""

    def pose(message: Any) -> Pose:
        return Pose(_stamp_ns(message), frame_name(message.frame_id), "", *_pose(message.pose, channel.topic))

    return _decoder(channel, pose)


def _decoder(channel: Channel, interpret: Callable[[Any], Any]) -> Callable[[Payload], Any]:
    """From payloads to what becomes of objects with a message's fields. Raises DecodeError, here or per payload."""
    if channel.message_encoding == "protobuf":
        deserialise = protobuf_deserialiser(channel)
    else:
        deserialise = partial(json_object, topic=channel.topic, object_of=lambda fields: SimpleNamespace(**fields))

    def decode(payload: Payload) -> Any:
        message = deserialise(payload)
        try:
            return interpret(message)
        except (AttributeError, TypeError, ValueError, OverflowError, StopIteration) as error:
            raise DecodeError(channel.topic, f"not a {channel.type_name}: {error!r}") from error

    return decode


def json_object(payload: Payload, topic: str, object_of: Callable[[dict[str, Any]], Any] = dict) -> Any:
    """The object that a payload is as JSON. Raises DecodeError."""
    try:
        message = json.loads(bytes(payload), object_hook=object_of)
    except (ValueError, RecursionError) as error:
        raise DecodeError(topic, f"not JSON: {error}") from error
    if not isinstance(message, (dict, SimpleNamespace)):
        raise DecodeError(topic, "its JSON is not an object")
    return message


def _stamp_ns(message: Any) -> int | None:
    stamp = getattr(message, "timestamp", None)
    if stamp is None:
        return None
    names = (("seconds", "nanos"), ("sec", "nsec"), ("sec", "nanosec"))
    seconds, nanos = next(each for each in names if hasattr(stamp, each[1]))
    return int(getattr(stamp, seconds)) * NS_PER_S + int(getattr(stamp, nanos))


def _pose(pose: Any, topic: str) -> tuple[Float, Float]:
    """Position (3,) and unit quaternion (4,). Raises DecodeError for what is not finite or out of reach."""
    position_m = np.array([float(getattr(pose.position, axis)) for axis in "xyz"])
    quat_xyzw, finite = unit_rows(np.array([[float(getattr(pose.orientation, axis)) for axis in "xyzw"]]))
    if not finite.all() or not (np.abs(position_m) <= FARTHEST_M).all():
        raise DecodeError(topic, f"its pose is not finite, or beyond {FARTHEST_M:.0e} m")
    return position_m, quat_xyzw[0]


def protobuf_deserialiser(channel: Channel) -> Callable[[Payload], Any]:
    """A function from payload to protobuf message; raises DecodeError, here or per payload."""
    # A tenth of a second of imports, for recordings that need them.
    from google.protobuf.message import DecodeError as ProtobufError
    from mcap.records import Schema
    from mcap_protobuf.decoder import DecoderFactory

    if len(channel.schema) > LARGEST_DEFINITION_BYTES:
        raise DecodeError(channel.topic, f"its definition is larger than {LARGEST_DEFINITION_BYTES} bytes")
    schema = Schema(id=1, name=channel.type_name, encoding="protobuf", data=channel.schema)
    try:
        decode = DecoderFactory().decoder_for("protobuf", schema)
    except Exception as error:  # untrusted descriptors fail in many ways
        reason = f"{channel.type_name}: its descriptors cannot be used ({type(error).__name__})"
        raise DecodeError(channel.topic, reason) from error
    assert decode is not None  # only for other encodings

    def deserialise(payload: Payload) -> Any:
        try:
            return decode(bytes(payload))
        except ProtobufError as error:
            raise DecodeError(channel.topic, f"not a {channel.type_name}: {error}") from error

    return deserialise
