from __future__ import annotations

import base64
import json
import re
import struct
from pathlib import Path
from typing import Any

import foxglove
import numpy as np
import pytest
from foxglove.channels import PointCloudChannel, PoseInFrameChannel
from foxglove.messages import (
    PackedElementField,
    PackedElementFieldNumericType,
    PointCloud,
    Pose,
    PoseInFrame,
    Quaternion,
    Timestamp,
    Vector3,
)
from mcap.reader import make_reader

from quadlog.errors import DecodeError
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.decoding import decoder_for

T_NS = 1_700_000_000_000_000_005
POINTS = np.array([(1, 2, 3, 7), (4, 5, 6, 8)], [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "<u2")])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Channel, bytes]]:
    """One PointCloud, turned by 90 degrees, and one PoseInFrame, as Foxglove's own SDK writes them."""
    path: Path = tmp_path_factory.mktemp("foxglove") / "f.mcap"
    kinds = PackedElementFieldNumericType
    fields = [
        PackedElementField(name=name, offset=offset, type=kind)
        for name, offset, kind in [("x", 0, kinds.Float32), ("y", 4, kinds.Float32), ("z", 8, kinds.Float32)]
    ]
    fields.append(PackedElementField(name="ring", offset=12, type=kinds.Uint16))
    turned = Pose(position=Vector3(x=10, y=0, z=0), orientation=Quaternion(x=0, y=0, z=0.5**0.5, w=0.5**0.5))
    stamp = Timestamp(sec=T_NS // 10**9, nsec=T_NS % 10**9)
    with foxglove.open_mcap(path):
        PointCloudChannel("/points").log(
            PointCloud(
                timestamp=stamp,
                frame_id="lidar",
                pose=turned,
                point_stride=POINTS.itemsize,
                fields=fields,
                data=POINTS.tobytes(),
            ),
            log_time=T_NS,
        )
        PoseInFrameChannel("/pose").log(PoseInFrame(timestamp=stamp, frame_id="map", pose=turned), log_time=T_NS)
    with path.open("rb") as stream:
        return {
            channel.topic: (
                Channel(channel.topic, schema.name, channel.message_encoding, schema.encoding, schema.data),
                message.data,
            )
            for schema, channel, message in make_reader(stream).iter_messages()
        }


def test_protobuf_point_cloud_with_its_pose_applied(recorded: dict[str, tuple[Channel, bytes]]) -> None:
    channel, payload = recorded["/points"]
    (cloud,) = decoder_for(channel)(payload)  # type: ignore[misc]
    assert cloud.stamp_ns == T_NS
    assert cloud.frame_id == "lidar"
    np.testing.assert_allclose(cloud.xyz_m, [[8, 1, 3], [5, 4, 6]], atol=1e-5)
    assert cloud.ring.tolist() == [7, 8]


def test_protobuf_pose(recorded: dict[str, tuple[Channel, bytes]]) -> None:
    channel, payload = recorded["/pose"]
    decode: Any = decoder_for(channel)
    (pose,) = decode(payload)
    assert (pose.stamp_ns, pose.frame_id, pose.position_m.tolist()) == (T_NS, "map", [10, 0, 0])
    np.testing.assert_allclose(pose.quat_xyzw, [0, 0, 0.5**0.5, 0.5**0.5])
    assert payload.count(struct.pack("<d", 10.0)) == 1
    with pytest.raises(DecodeError, match="position is not finite, or beyond"):
        decode(payload.replace(struct.pack("<d", 10.0), struct.pack("<d", 1e300)))


def test_broken_protobuf_is_one_decode_error(recorded: dict[str, tuple[Channel, bytes]]) -> None:
    channel, payload = recorded["/points"]
    with pytest.raises(DecodeError, match=re.escape("/points: not a foxglove.PointCloud")):
        decoder_for(channel)(payload[: len(payload) // 2])  # type: ignore[misc]
    with pytest.raises(DecodeError, match="descriptors"):
        decoder_for(Channel("/points", "foxglove.PointCloud", "protobuf", "protobuf", b"\xff\xff"))


def json_pose(x_m: float) -> dict[str, Any]:
    return {"position": {"x": x_m, "y": 2, "z": 3}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 2}}


def json_cloud(**changed: Any) -> bytes:
    message = {
        "timestamp": {"sec": T_NS // 10**9, "nsec": T_NS % 10**9},
        "frame_id": "lidar",
        "pose": {"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}},
        "point_stride": POINTS.itemsize,
        "fields": [{"name": axis, "offset": 4 * i, "type": 7} for i, axis in enumerate("xyz")],
        "data": base64.b64encode(POINTS.tobytes()).decode(),
    }
    return json.dumps({**message, **changed}).encode()


JSON_CLOUDS = Channel("/points", "foxglove.PointCloud", "json", "jsonschema", b"{}")


def test_json_point_cloud() -> None:
    (cloud,) = decoder_for(JSON_CLOUDS)(json_cloud())  # type: ignore[misc]
    assert cloud.stamp_ns == T_NS
    np.testing.assert_array_equal(cloud.xyz_m, [[1, 2, 3], [4, 5, 6]])
    (empty,) = decoder_for(JSON_CLOUDS)(json_cloud(data=""))  # type: ignore[misc]
    assert len(empty.xyz_m) == 0


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"[1]",
        b"[" * 100_000,
        json_cloud(data="***"),
        json_cloud(point_stride=3),
        json_cloud(fields=[{"name": "x", "offset": 10**9, "type": 7}]),
        json_cloud(fields=None),
        json_cloud(pose=json_pose(10**400)),
        json_cloud(timestamp={"sec": float("inf"), "nsec": 0}),
    ],
)
def test_broken_json_is_one_decode_error(payload: bytes) -> None:
    with pytest.raises(DecodeError):
        decoder_for(JSON_CLOUDS)(payload)  # type: ignore[misc]


def test_json_pose() -> None:
    channel = Channel("/pose", "foxglove.PoseInFrame", "json", "jsonschema", b"")
    decode = decoder_for(channel)
    message = {"timestamp": {"sec": 1, "nsec": 5}, "frame_id": "map"}
    (decoded,) = decode(json.dumps(message | {"pose": json_pose(1)}).encode())  # type: ignore[misc]
    assert (decoded.stamp_ns, decoded.position_m.tolist()) == (1_000_000_005, [1, 2, 3])
    assert decoded.quat_xyzw.tolist() == [0, 0, 0, 1]
    for x_m in (float("nan"), 1e300, 10**400):
        with pytest.raises(DecodeError):
            decode(json.dumps(message | {"pose": json_pose(x_m)}).encode())  # type: ignore[misc]
