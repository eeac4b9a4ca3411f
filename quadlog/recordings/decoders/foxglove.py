"""Foxglove's own PointCloud and PoseInFrame, as protobuf or JSON."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from quadlog.errors import DecodeError
from quadlog.geometry import apply_transform, transform_from_quat
from quadlog.messages import NS_PER_S, PointCloud, Pose
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.payload import Header, Payload, frame_name
from quadlog.recordings.decoders.point_cloud import Block, cloud_from_block
from quadlog.recordings.decoders.type_definitions import LARGEST_DEFINITION_BYTES
from quadlog.recordings.plugged import parts_of

# foxglove.PackedElementField numeric types, in their order from 1.
NUMERIC_TYPES = ("u1", "i1", "<u2", "<i2", "<u4", "<i4", "<f4", "<f8")
NUMERIC_NAMES = ("UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64")


def cloud(message: Any, topic: str) -> Iterator[PointCloud]:
    """Of a foxglove.PointCloud; its pose, the origin in frame_id, is applied to the points. Raises DecodeError."""
    layout = {}
    for each in message.fields:
        kind = NUMERIC_NAMES.index(each.type) + 1 if isinstance(each.type, str) else int(each.type)
        if 1 <= kind <= len(NUMERIC_TYPES) and each.offset >= 0:
            layout[each.name] = int(each.offset), NUMERIC_TYPES[kind - 1]
    data, stride, frame = message.data, int(message.point_stride), frame_name(message.frame_id)
    data = base64.b64decode(data, validate=True) if isinstance(data, str) else data
    if data and (stride <= 0 or len(data) % stride):
        raise DecodeError(topic, f"{len(data)} bytes of points are no multiple of point_stride {stride}")
    block = Block(data, 0, len(data), 1, len(data) // stride if data else 0, len(data), stride)
    made = cloud_from_block(topic, block, layout, Header(_stamp_ns(message), frame))
    if getattr(message, "pose", None):
        (placed,) = parts_of(next(pose(message, topic)), Pose, topic)
        position_m, quat_xyzw = placed.rows["position_m"][0], placed.rows["quat_xyzw"][0]
        if position_m.any() or abs(quat_xyzw[3]) != 1:
            xyz_m = apply_transform(transform_from_quat(position_m, quat_xyzw), made.xyz_m)
            made = replace(made, xyz_m=xyz_m.astype(np.float32))
    yield made


def pose(message: Any, _: str) -> Iterator[Pose]:
    """Of a message with a pose, as foxglove.PoseInFrame."""
    position_m = np.array([float(getattr(message.pose.position, axis)) for axis in "xyz"])
    quat_xyzw = np.array([float(getattr(message.pose.orientation, axis)) for axis in "xyzw"])
    yield Pose(_stamp_ns(message), frame_name(message.frame_id), "", position_m, quat_xyzw)


def json_object(payload: Payload, topic: str, object_of: Callable[[Mapping[str, Any]], Any] = dict) -> Any:
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
