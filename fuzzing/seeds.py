"""Small sound recordings, made from code: what mutations start from."""

from __future__ import annotations

import random
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import zstandard
from mcap.writer import CompressionType, IndexType

from quadlog.messages import Imu, Message, Odometry, PointCloud, Pose, Transforms, UwbRanges
from quadlog.simulation.sensors.lidar import SimulatedScan
from quadlog.simulation.synthetic.ros_encoding import ENCODED, RosEncoder
from tests.lab import recordings as lab

BASE_NS = lab.BASE_NS
MESSAGES = 24


class Encoded(NamedTuple):
    """A message as one generation of ROS writes it."""

    topic: str
    type_name: str
    definition: tuple[str, str]
    t_ns: int
    payload: bytes


def _scene(t_ns: int, i: int) -> Iterator[tuple[str, Message | SimulatedScan]]:
    """One of every type that the encoder knows, as at the i-th instant."""
    rng = random.Random(i)
    level, zero = np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3)
    place_m = np.array([0.1 * i, 0.0, 0.3])
    xyz_m = np.array([[rng.uniform(1, 5) for _ in range(3)] for _ in range(8)], np.float32)
    cloud = PointCloud(t_ns, "lidar", xyz_m, np.arange(8, dtype=np.uint16), np.arange(8, dtype=np.int64) * 1000)
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
    encoder = RosEncoder()
    found = []
    for i, (topic, message) in enumerate(scene):
        name, cdr = ENCODED[type(message)][0], encoder.encode(message)
        payload, text, digest = lab.in_ros1(name, cdr) if ros == 1 else (cdr, encoder.definition(name), "")
        found.append(Encoded(topic, name, (text, digest), BASE_NS + i * 10_000_000, payload))
    return tuple(found)


def _written(write: Any, messages: tuple[Encoded, ...], *options: Any, **named: Any) -> bytes:
    """The file that one of the lab's writers makes of these messages."""
    rows = [(each.topic, each.t_ns, each.payload) for each in messages]
    types = {each.topic: (each.type_name, *each.definition) for each in messages}
    with TemporaryDirectory() as folder:
        content: bytes = write(Path(folder) / "walk", rows, *options, types=types, **named).read_bytes()
        return content


def mcap(messages: tuple[Encoded, ...], **options: Any) -> bytes:
    """Options are those of the format's own library."""
    return _written(lab.mcap, messages, **({"chunk_size": 2000, "compression": CompressionType.NONE} | options))


@cache
def recordings() -> dict[str, bytes]:
    """Every kind of container with the same messages; the first byte of a case chooses one, in this order."""
    one, two = walk(1), walk(2)
    bags = {kind: _written(lab.bag, one, kind, 2000) for kind in ("", "bz2", "lz4")}
    return {
        "mcap": mcap(two),
        "mcap-zstd": mcap(two, compression=CompressionType.ZSTD),
        "mcap-lz4": mcap(two, compression=CompressionType.LZ4),
        "mcap-no-crc": mcap(two, enable_crcs=False, enable_data_crcs=False),
        "mcap-unchunked": mcap(two, use_chunking=False),
        "mcap-no-index": mcap(two, index_types=IndexType.NONE, use_statistics=False, use_summary_offsets=False),
        **{f"bag-{kind}".rstrip("-"): content for kind, content in bags.items()},
        "db3": _written(lab.db3, two),
        "mcap-zst": zstandard.compress(mcap(two)),
    }


def write_split(folder: Path) -> str:
    """A ROS 2 bag folder of two parts; returns the text of its metadata.yaml."""
    half = MESSAGES // 2
    for number, part in enumerate((walk(2)[:half], walk(2)[half:])):
        (folder / f"walk_{number}.mcap").write_bytes(mcap(part))
    topics = "".join(
        f"    - topic_metadata: {{name: {topic}, type: {type_name}, serialization_format: cdr, "
        f'offered_qos_profiles: ""}}\n      message_count: {half}\n'
        for topic, type_name in {each.topic: each.type_name for each in walk(2)}.items()
    )
    return (
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n"
        f"  duration: {{nanoseconds: 230000000}}\n  starting_time: {{nanoseconds_since_epoch: {BASE_NS}}}\n"
        f"  message_count: {MESSAGES}\n  topics_with_message_count:\n{topics}"
        '  compression_format: ""\n  compression_mode: ""\n'
        "  relative_file_paths:\n    - walk_0.mcap\n    - walk_1.mcap\n"
    )
