from __future__ import annotations

import base64
import json
import struct
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
from tests.lab import decoded as lab

T_NS = 1_700_000_000_000_000_005
POINTS = np.array([(1, 2, 3, 7), (4, 5, 6, 8)], [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "<u2")])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """One PointCloud, turned by 90 degrees, and one PoseInFrame, as Foxglove's own SDK writes them: by topic."""
    path, kinds = tmp_path_factory.mktemp("foxglove") / "f.mcap", PackedElementFieldNumericType
    types = {"x": kinds.Float32, "y": kinds.Float32, "z": kinds.Float32, "ring": kinds.Uint16}
    fields = [PackedElementField(name=name, offset=4 * i, type=kind) for i, (name, kind) in enumerate(types.items())]
    turned = Pose(position=Vector3(x=10, y=0, z=0), orientation=Quaternion(x=0, y=0, z=0.5**0.5, w=0.5**0.5))
    where = {"timestamp": Timestamp(sec=T_NS // 10**9, nsec=T_NS % 10**9), "pose": turned}
    points = {"point_stride": POINTS.itemsize, "fields": fields, "data": POINTS.tobytes()}
    with foxglove.open_mcap(path):
        PointCloudChannel("/points").log(PointCloud(frame_id="lidar", **where, **points), log_time=T_NS)
        PoseInFrameChannel("/pose").log(PoseInFrame(frame_id="map", **where), log_time=T_NS)
    with path.open("rb") as stream:
        read = list(make_reader(stream).iter_messages())
    return {c.topic: (Channel(c.topic, s.name, c.message_encoding, s.encoding, s.data), m.data) for s, c, m in read}


def decoded(channel: Channel, payload: bytes) -> Any:
    (message,) = lab.decoded(channel, payload)
    return message


def test_protobuf_with_its_pose_applied(recorded):
    cloud = decoded(*recorded["/points"])
    assert (cloud.stamp_ns, cloud.frame_id, cloud.ring.tolist()) == (T_NS, "lidar", [7, 8])
    np.testing.assert_allclose(cloud.xyz_m, [[8, 1, 3], [5, 4, 6]], atol=1e-5)
    channel, payload = recorded["/pose"]
    pose = decoded(channel, payload)
    assert (pose.stamp_ns, pose.frame_id, pose.position_m.tolist()) == (T_NS, "map", [10, 0, 0])
    np.testing.assert_allclose(pose.quat_xyzw, [0, 0, 0.5**0.5, 0.5**0.5])
    assert payload.count(struct.pack("<d", 10.0)) == 1
    with pytest.raises(DecodeError):
        decoded(channel, payload.replace(struct.pack("<d", 10.0), struct.pack("<d", 1e300)))


def test_broken_protobuf_is_one_decode_error(recorded):
    channel, payload = recorded["/points"]
    with pytest.raises(DecodeError, match="/points"):
        decoded(channel, payload[: len(payload) // 2])
    with pytest.raises(DecodeError, match="descriptors"):
        decoded(Channel("/points", "foxglove.PointCloud", "protobuf", "protobuf", b"\xff\xff"), b"")


CLOUDS, POSES = (
    Channel("/json", f"foxglove.{name}", "json", "jsonschema", b"{}") for name in ("PointCloud", "PoseInFrame")
)
STAMP = {"timestamp": {"sec": T_NS // 10**9, "nsec": T_NS % 10**9}, "frame_id": "lidar"}


def json_pose(x_m: float, y_m: float = 2, z_m: float = 3) -> dict[str, Any]:
    turn = {"x": 0, "y": 0, "z": 0, "w": 2}
    return {"pose": {"position": {"x": x_m, "y": y_m, "z": z_m}, "orientation": turn}}


def json_cloud(**changed: Any) -> bytes:
    fields = [{"name": axis, "offset": 4 * i, "type": 7} for i, axis in enumerate("xyz")]
    data = base64.b64encode(POINTS.tobytes()).decode()
    body = {"point_stride": POINTS.itemsize, "fields": fields, "data": data}
    return json.dumps(STAMP | json_pose(0, 0, 0) | body | changed).encode()


def test_json() -> None:
    cloud = decoded(CLOUDS, json_cloud())
    assert cloud.stamp_ns == T_NS
    np.testing.assert_array_equal(cloud.xyz_m, [[1, 2, 3], [4, 5, 6]])
    assert len(decoded(CLOUDS, json_cloud(data="")).xyz_m) == 0
    pose = decoded(POSES, json.dumps(STAMP | json_pose(1)).encode())
    assert (pose.stamp_ns, pose.position_m.tolist(), pose.quat_xyzw.tolist()) == (T_NS, [1, 2, 3], [0, 0, 0, 1])


@pytest.mark.parametrize(
    ("channel", "payload"),
    [
        *((POSES, json.dumps(STAMP | json_pose(x_m)).encode()) for x_m in (float("nan"), 1e300, 10**400)),
        *((CLOUDS, payload) for payload in (b"", b"[1]", b"[" * 100_000)),
        (CLOUDS, json_cloud(data="***")),
        (CLOUDS, json_cloud(point_stride=3)),
        (CLOUDS, json_cloud(fields=[{"name": "x", "offset": 10**9, "type": 7}])),
        (CLOUDS, json_cloud(fields=None)),
        (CLOUDS, json_cloud(**json_pose(10**400))),
        (CLOUDS, json_cloud(timestamp={"sec": float("inf"), "nsec": 0})),
    ],
)
def test_broken_json_is_one_decode_error(channel: Channel, payload: bytes) -> None:
    with pytest.raises(DecodeError):
        decoded(channel, payload)
