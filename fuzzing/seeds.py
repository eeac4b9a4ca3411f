"""Small sound recordings, made from code: what mutations start from."""

from __future__ import annotations

import io
import random
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import zstandard
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as BagWriter

from quadlog.messages import Imu, Message, Odometry, PointCloud, Pose, Transforms, UwbRanges
from quadlog.simulation.sensors.lidar import SimulatedScan
from quadlog.simulation.synthetic.ros_encoding import TYPE_NAMES, Definition, RosEncoder
from quadlog.simulation.synthetic.writer import Db3Recording

BASE_NS = 1_700_000_000 * 10**9
MESSAGES = 24


class Encoded(NamedTuple):
    """A message as one generation of ROS writes it."""

    topic: str
    type_name: str
    definition: Definition
    t_ns: int
    payload: bytes


def _scene(t_ns: int, i: int) -> Iterator[tuple[str, Message | SimulatedScan]]:
    """One of every type that the encoder knows, as at the i-th instant."""
    rng = random.Random(i)
    level, zero = np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3)
    place_m = np.array([0.1 * i, 0.0, 0.3])
    cloud = PointCloud(
        t_ns,
        "lidar",
        np.array([[rng.uniform(1, 5) for _ in range(3)] for _ in range(8)], np.float32),
        np.arange(8, dtype=np.uint16),
        np.arange(8, dtype=np.int64) * 1000,
    )
    yield "/points", SimulatedScan(cloud, np.ones(8, np.float32), np.zeros(8, np.uint8), np.ones(8))
    yield "/uwb", UwbRanges(t_ns, 0, np.arange(4), np.array([3.0, 4.0, 5.0, 6.0]) + 0.1 * i)
    yield "/imu", Imu(t_ns, "base", level, np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, 9.81]))
    yield "/odom", Odometry(t_ns, "odom", "base", place_m, level, np.array([0.5, 0.0, 0.0]), zero)
    yield "/pose", Pose(t_ns, "map", "base", place_m, level)
    yield "/tf", Transforms(t_ns, (Pose(t_ns, "odom", "base", place_m, level),), static=False)


@cache
def encoded(ros: int) -> tuple[Encoded, ...]:
    """A message of every type that the encoder knows, each on its topic, 10 ms apart, in ROS 1 or ROS 2."""
    return _encode(ros, list(_scene(BASE_NS, 0)))


@cache
def walk(ros: int) -> tuple[Encoded, ...]:
    """MESSAGES messages, ranges and poses in turn, 10 ms apart: little enough to be damaged often."""
    scene = [each for i in range(MESSAGES // 2) for each in _scene(BASE_NS + i * 20_000_000, i)]
    return _encode(ros, [each for each in scene if each[0] in ("/uwb", "/pose")])


def _encode(ros: int, scene: list[tuple[str, Message | SimulatedScan]]) -> tuple[Encoded, ...]:
    encoder = RosEncoder(1 if ros == 1 else 2)
    return tuple(
        Encoded(
            topic,
            name := TYPE_NAMES[type(message)],
            encoder.definition(name),
            BASE_NS + i * 10_000_000,
            encoder.encode(message, i),
        )
        for i, (topic, message) in enumerate(scene)
    )


def mcap(messages: tuple[Encoded, ...], **options: Any) -> bytes:
    """As the format's own library writes it; options are its Writer's."""
    out = io.BytesIO()
    writer = McapWriter(out, **({"chunk_size": 2000, "compression": CompressionType.NONE} | options))
    writer.start("ros2", "fuzz")
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    for i, each in enumerate(messages):
        if each.type_name not in schemas:
            schemas[each.type_name] = writer.register_schema(each.type_name, "ros2msg", each.definition.text.encode())
        if each.topic not in channels:
            channels[each.topic] = writer.register_channel(each.topic, "cdr", schemas[each.type_name])
        writer.add_message(channels[each.topic], each.t_ns, each.payload, each.t_ns, i)
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


def bag(messages: tuple[Encoded, ...], compression: str = "") -> bytes:
    """As rosbags writes it."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.bag"
        writer = BagWriter(path)
        writer.chunk_threshold = 2000
        if compression:
            writer.set_compression(BagWriter.CompressionFormat[compression])
        with writer:
            connections: dict[str, Any] = {}
            for each in messages:
                if each.topic not in connections:
                    text, digest = each.definition
                    connections[each.topic] = writer.add_connection(
                        each.topic, each.type_name, msgdef=text, md5sum=digest
                    )
                writer.write(connections[each.topic], each.t_ns, each.payload)
        return path.read_bytes()


def db3(messages: tuple[Encoded, ...]) -> bytes:
    """As rosbag2 keeps it."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.db3"
        writer = Db3Recording(path)
        for i, each in enumerate(messages):
            if all(each.topic != before.topic for before in messages[:i]):
                writer.add_topic(each.topic, each.type_name, each.definition)
            writer.write(each.topic, each.t_ns, i, each.payload)
        writer.close()
        return path.read_bytes()


@cache
def recordings() -> dict[str, bytes]:
    """Every kind of container with the same messages; the first byte of a case chooses one, in this order."""
    one, two = walk(1), walk(2)
    bare = {"enable_crcs": False, "enable_data_crcs": False}
    return {
        "mcap": mcap(two),
        "mcap-zstd": mcap(two, compression=CompressionType.ZSTD),
        "mcap-lz4": mcap(two, compression=CompressionType.LZ4),
        "mcap-no-crc": mcap(two, **bare),
        "mcap-unchunked": mcap(two, use_chunking=False),
        "mcap-no-index": mcap(two, index_types=IndexType.NONE, use_statistics=False, use_summary_offsets=False),
        "bag": bag(one),
        "bag-bz2": bag(one, "BZ2"),
        "bag-lz4": bag(one, "LZ4"),
        "db3": db3(two),
        "mcap-zst": zstandard.compress(mcap(two)),
    }


def write_split(folder: Path) -> str:
    """A ROS 2 bag folder of two parts; returns the text of its metadata.yaml."""
    half = len(walk(2)) // 2
    parts = [walk(2)[:half], walk(2)[half:]]
    for number, part in enumerate(parts):
        (folder / f"walk_{number}.mcap").write_bytes(mcap(part))
    topics = {each.topic: each.type_name for each in walk(2)}
    lines = [
        "rosbag2_bagfile_information:",
        "  version: 5",
        "  storage_identifier: mcap",
        "  duration: {nanoseconds: 230000000}",
        f"  starting_time: {{nanoseconds_since_epoch: {BASE_NS}}}",
        f"  message_count: {MESSAGES}",
        "  topics_with_message_count:",
    ]
    for topic, type_name in topics.items():
        lines.append(
            f"    - topic_metadata: {{name: {topic}, type: {type_name}, serialization_format: cdr, "
            f'offered_qos_profiles: ""}}\n      message_count: {MESSAGES // len(topics)}'
        )
    lines += ['  compression_format: ""', '  compression_mode: ""', "  relative_file_paths:"]
    lines += [f"    - walk_{number}.mcap" for number in range(len(parts))]
    return "\n".join([*lines, ""])
