"""ROS messages of both worlds, written by rosbags: the oracle for what quadlog reads by hand; and a log of them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from quadlog.recordings.containers.container import Budget, Channel, Loss, RawMessage
from quadlog.storage.atomic_write import part_prefix


class Ros:
    """Makes and serialises messages of one ROS generation (`ros1` or `cdr`)."""

    def __init__(self, encoding: str) -> None:
        self.encoding = encoding
        self.store: Typestore = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)

    def type(self, name: str) -> Any:
        return self.store.types[name]

    def stamp(self, t_ns: int) -> Any:
        return self.type("builtin_interfaces/msg/Time")(t_ns // 10**9, t_ns % 10**9)

    def header(self, t_ns: int, frame: str = "lidar") -> Any:
        parts = (self.stamp(t_ns), frame)
        return self.type("std_msgs/msg/Header")(*((7, *parts) if self.encoding == "ros1" else parts))

    def serialise(self, message: Any, *, big_endian: bool = False) -> bytes:
        name = message.__msgtype__
        if self.encoding == "ros1":
            return bytes(self.store.serialize_ros1(message, name))
        return bytes(self.store.serialize_cdr(message, name, little_endian=not big_endian))

    def channel(self, topic: str, type_name: str) -> Channel:
        """A channel with its definition embedded."""
        text, _ = self.store.generate_msgdef(type_name, ros_version=1 if self.encoding == "ros1" else 2)
        kind = "ros1msg" if self.encoding == "ros1" else "ros2msg"
        return Channel(topic, type_name, self.encoding, kind, text.encode())

    def pose(self, xyz: tuple[float, ...], xyzw: tuple[float, ...]) -> Any:
        return self.type("geometry_msgs/msg/Pose")(
            self.type("geometry_msgs/msg/Point")(*xyz), self.type("geometry_msgs/msg/Quaternion")(*xyzw)
        )

    def odometry(self, t_ns: int, x_m: float, frame: str = "odom") -> Any:
        pose = self.type("geometry_msgs/msg/PoseWithCovariance")(
            self.pose((x_m, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), np.zeros(36)
        )
        velocity = self.type("geometry_msgs/msg/Twist")(self.vector(0.5, 0.0, 0.0), self.vector(0.0, 0.0, 0.25))
        twist = self.type("geometry_msgs/msg/TwistWithCovariance")(velocity, np.zeros(36))
        return self.type("nav_msgs/msg/Odometry")(self.header(t_ns, frame), "base_link", pose, twist)

    def range(self, t_ns: int, range_m: float) -> Any:
        return self.type("sensor_msgs/msg/Range")(self.header(t_ns, ""), 0, 0.0, 0.0, 0.0, range_m)

    def transform(self, t_ns: int, parent: str, child: str, xyz: tuple[float, ...], xyzw: tuple[float, ...]) -> Any:
        inner = self.type("geometry_msgs/msg/Transform")(
            self.vector(*xyz), self.type("geometry_msgs/msg/Quaternion")(*xyzw)
        )
        return self.type("geometry_msgs/msg/TransformStamped")(self.header(t_ns, parent), child, inner)

    def tf(self, *transforms: Any) -> Any:
        return self.type("tf2_msgs/msg/TFMessage")(list(transforms))

    def cloud(self, t_ns: int, xyz_m: np.ndarray, frame: str = "lidar") -> Any:
        field = self.type("sensor_msgs/msg/PointField")
        fields = [field(name, 4 * i, 7, 1) for i, name in enumerate("xyz")]
        data = np.ascontiguousarray(xyz_m, "<f4").view(np.uint8).reshape(-1)
        kind = self.type("sensor_msgs/msg/PointCloud2")
        return kind(self.header(t_ns, frame), 1, len(xyz_m), fields, False, 12, 12 * len(xyz_m), data, True)

    def vector(self, *xyz: float) -> Any:
        return self.type("geometry_msgs/msg/Vector3")(*xyz)


class FakeContainer:
    """Messages in memory behind the Container protocol. `add` takes a channel, a log time and a payload."""

    def __init__(self) -> None:
        self.path = Path("fake.mcap")
        self.losses: list[Loss] = []
        self.warnings: list[str] = []
        self.known: dict[tuple[str, str], Channel] = {}
        self.raw: list[RawMessage] = []
        self.asked: list[tuple[int | None, int | None]] = []

    def add(self, channel: Channel, t_ns: int, payload: bytes) -> None:
        key = channel.topic, channel.type_name
        before = self.known.get(key, replace(channel, count=0))
        self.known[key] = replace(before, count=max(before.count + 1, channel.count))
        self.raw.append(RawMessage(before, t_ns, payload))

    @property
    def channels(self) -> tuple[Channel, ...]:
        return tuple(self.known.values())

    @property
    def span_ns(self) -> tuple[int, int] | None:
        times = [each.log_time_ns for each in self.raw]
        return (min(times), max(times)) if times else None

    def excerpt(self, budget: Budget) -> None:
        """It is small."""

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        self.asked.append((start_ns, end_ns))
        for each in sorted(self.raw, key=lambda raw: raw.log_time_ns):
            late = end_ns is not None and each.log_time_ns >= end_ns
            early = start_ns is not None and each.log_time_ns < start_ns
            if not early and not late and (topics is None or each.channel.topic in topics):
                yield each

    def close(self) -> None:
        pass


class Log:
    """A container being filled with ROS 2 messages."""

    def __init__(self, ros: Ros) -> None:
        self.ros, self.container = ros, FakeContainer()

    def add(self, topic: str, t_ns: int, message: Any) -> None:
        channel = self.ros.channel(topic, message.__msgtype__)
        self.container.add(channel, t_ns, self.ros.serialise(message))


@pytest.fixture
def log(both_ros: SimpleNamespace) -> Log:
    return Log(both_ros.cdr)


@pytest.fixture(scope="session", params=["ros1", "cdr"])
def ros(request: pytest.FixtureRequest) -> Ros:
    return Ros(request.param)


@pytest.fixture(scope="session")
def both_ros() -> SimpleNamespace:
    return SimpleNamespace(ros1=Ros("ros1"), cdr=Ros("cdr"))


@pytest.fixture(scope="session")
def left_part() -> str:
    """The name of a file that a process of this host had begun, and that is dead now."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return f"{part_prefix(process.pid)}00000000.part"
