"""Foxglove's own PointCloud and PoseInFrame, as protobuf or JSON."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from quadlog.errors import DecodeError
from quadlog.geometry import apply_transform, transform_from_quat
from quadlog.messages import Float, PointCloud, Pose
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoders.payload import Payload, frame_name, nanoseconds
from quadlog.recordings.decoders.point_cloud import Block, Column, MakeCloud, check_block, cloud_from_block
from quadlog.recordings.decoders.pose import normalised, place, unit_quaternion, within_reach
from quadlog.recordings.decoders.type_definitions import LARGEST_DEFINITION_BYTES

# foxglove.PackedElementField numeric types, in their order from 1.
NUMERIC_TYPES = ("u1", "i1", "<u2", "<i2", "<u4", "<i4", "<f4", "<f8")
NUMERIC_NAMES = ("UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64")

PoseParts = tuple[Float, Float]  # position (3,), quaternion xyzw (4,)


def decode_point_cloud(message: Any, topic: str, make_cloud: MakeCloud = cloud_from_block) -> PointCloud:
    """A protobuf foxglove.PointCloud; its pose, the cloud's origin in frame_id, is applied to the points."""
    fields = {each.name: (each.offset, each.type) for each in message.fields}
    pose = _proto_pose(message.pose, topic) if message.HasField("pose") else None
    stamp = _proto_stamp(message.timestamp)
    return _cloud(
        topic, stamp, frame_name(message.frame_id), message.point_stride, fields, message.data, pose, make_cloud
    )


def decode_pose_in_frame(message: Any, topic: str) -> Pose:
    """A protobuf foxglove.PoseInFrame."""
    position, quaternion = _proto_pose(message.pose, topic)
    return Pose(_proto_stamp(message.timestamp), frame_name(message.frame_id), "", position, quaternion)


def json_point_cloud_decoder(topic: str, make_cloud: MakeCloud = cloud_from_block) -> Callable[[Payload], PointCloud]:
    """A decoder of JSON foxglove.PointCloud payloads (data in base64)."""

    def decode(payload: Payload) -> PointCloud:
        """One payload as a cloud, points in metres. Raises DecodeError."""
        message = json_object(payload, topic)
        try:
            fields = {str(each["name"]): (int(each["offset"]), _numeric(each["type"])) for each in message["fields"]}
            data = base64.b64decode(message["data"], validate=True)
            stride = int(message["point_stride"])
            pose = _json_pose(message["pose"], topic) if message.get("pose") else None
            stamp, frame = _json_stamp(message), frame_name(message["frame_id"])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise DecodeError(topic, f"not a foxglove.PointCloud: {error!r}") from error
        return _cloud(topic, stamp, frame, stride, fields, data, pose, make_cloud)

    return decode


def json_pose_decoder(topic: str) -> Callable[[Payload], Pose]:
    """A decoder of JSON foxglove.PoseInFrame payloads."""

    def decode(payload: Payload) -> Pose:
        message = json_object(payload, topic)
        try:
            position, quaternion = _json_pose(message["pose"], topic)
            return Pose(_json_stamp(message), frame_name(message["frame_id"]), "", position, quaternion)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise DecodeError(topic, f"not a foxglove.PoseInFrame: {error!r}") from error

    return decode


def _cloud(
    topic: str,
    stamp: int | None,
    frame: str,
    stride: int,
    fields: Mapping[str, tuple[int, int]],
    data: bytes,
    pose: PoseParts | None,
    make_cloud: MakeCloud,
) -> PointCloud:
    layout = {
        name: Column(offset, np.dtype(NUMERIC_TYPES[kind - 1]))
        for name, (offset, kind) in fields.items()
        if 1 <= kind <= len(NUMERIC_TYPES) and offset >= 0
    }
    if not data:
        return PointCloud(stamp, frame_name(frame), np.empty((0, 3), np.float32))
    if stride <= 0 or len(data) % stride:
        raise DecodeError(topic, f"{len(data)} bytes of points are no multiple of point_stride {stride}")
    block = Block(data, 0, 1, len(data) // stride, len(data), stride)
    check_block(topic, block, len(data), layout)
    cloud = make_cloud(topic, block, layout, stamp, frame_name(frame))
    if pose is None or (not pose[0].any() and abs(pose[1][3]) == 1):
        return cloud
    xyz_m = apply_transform(transform_from_quat(*pose), cloud.xyz_m).astype(np.float32)
    return replace(cloud, xyz_m=xyz_m)


def _proto_stamp(timestamp: Any) -> int:
    return nanoseconds(int(timestamp.seconds), int(timestamp.nanos))


def _proto_pose(pose: Any, topic: str) -> PoseParts:
    at, turn = pose.position, pose.orientation
    return place(at, topic), unit_quaternion(turn, topic)


def json_object(payload: Payload, topic: str) -> dict[str, Any]:
    """The object that a payload is as JSON. Raises DecodeError."""
    try:
        message = json.loads(bytes(payload))
    except (ValueError, RecursionError) as error:
        raise DecodeError(topic, f"not JSON: {error}") from error
    if not isinstance(message, dict):
        raise DecodeError(topic, "its JSON is not an object")
    return message


def _json_stamp(message: dict[str, Any]) -> int | None:
    stamp = message.get("timestamp")
    if stamp is None:
        return None
    nanos = stamp["nsec"] if "nsec" in stamp else stamp["nanosec"]
    return nanoseconds(int(stamp["sec"]), int(nanos))


def _json_pose(pose: dict[str, Any], topic: str) -> PoseParts:
    at, turn = pose["position"], pose["orientation"]
    x, y, z = (float(at[axis]) for axis in "xyz")
    return np.array(within_reach(x, y, z, topic), np.float64), normalised([float(turn[axis]) for axis in "xyzw"], topic)


def _numeric(kind: int | str) -> int:
    return NUMERIC_NAMES.index(kind) + 1 if isinstance(kind, str) else int(kind)


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
