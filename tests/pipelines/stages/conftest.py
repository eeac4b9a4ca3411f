"""Short recordings of a walk, each with something odd about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer

from quadlog.recordings.containers.open import open_container
from quadlog.simulation.synthetic.follow import synthesize
from quadlog.simulation.synthetic.recording import IMU_TOPIC, LIDAR_TOPIC, ROBOT_TRUTH_TOPIC, START_NS, TF_STATIC_TOPIC
from quadlog.simulation.synthetic.ros_encoding import TYPE_NAMES, RosEncoder
from quadlog.simulation.synthetic.writer import WRITERS

RECORDING = synthesize(seed=0, duration_s=3.2, azimuth_steps=240)
WANTED = (TF_STATIC_TOPIC, IMU_TOPIC, ROBOT_TRUTH_TOPIC, LIDAR_TOPIC)
HOUR_NS, MINUTE_NS, S_NS, MS_NS = 3_600_000_000_000, 60_000_000_000, 1_000_000_000, 1_000_000

Row = tuple[str, int, str, bytes]
"""Topic, log time, type and payload."""
Change = Callable[[int, int, Any], tuple[int, Any]]
"""Of the n-th cloud: log time and scan -> log time, and scan or payload."""


def rows(
    change: Change = lambda n, log_ns, scan: (log_ns, scan), ros_version: int = 2, beside_ns: int = 0
) -> list[Row]:
    """The messages in the order in which they are written; beside_ns is added to all stamps but the clouds'."""
    encoder, made, n = RosEncoder(ros_version), [], 0
    for topic, log_ns, message in RECORDING.messages():
        if topic not in WANTED:
            continue
        type_name, changed = TYPE_NAMES[type(message)], message
        if topic == LIDAR_TOPIC:
            log_ns, changed = change(n, log_ns, message)
            n += 1
        elif beside_ns:
            changed = replace(message, stamp_ns=message.stamp_ns + beside_ns)
        payload = changed if isinstance(changed, bytes) else encoder.encode(changed, 0)
        made.append((topic, log_ns, type_name, payload))
    return made


def one(wanted: int, changed: Callable[[int, Any], Any]) -> list[Row]:
    """With one cloud changed, given its log time."""
    return rows(lambda n, log_ns, scan: (log_ns, changed(log_ns, scan) if n == wanted else scan))


def stamped(scan: Any, stamp_ns: int) -> Any:
    return replace(scan, cloud=replace(scan.cloud, stamp_ns=stamp_ns))


def written(path: Path, messages: list[Row]) -> Path:
    writer = WRITERS[path.suffix[1:]](path)
    encoder, known = RosEncoder(writer.ros_version), set()
    for topic, log_ns, type_name, payload in messages:
        if topic not in known:
            known.add(topic)
            writer.add_topic(topic, type_name, encoder.definition(type_name))
        writer.write(topic, log_ns, 0, payload)
    writer.close()
    return path


def in_chunks(
    path: Path, messages: list[Row], chunk_bytes: int, before_end: Callable[[Writer], None] = lambda writer: None
) -> Path:
    """An MCAP with chunks of about a size; before_end may change what its summary will say."""
    encoder = RosEncoder(2)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_bytes)
        writer.start("ros2", "test")
        channels: dict[str, int] = {}
        for topic, log_ns, type_name, payload in messages:
            if topic not in channels:
                schema = writer.register_schema(type_name, "ros2msg", encoder.definition(type_name).text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], log_ns, payload, log_ns)
        before_end(writer)
        writer.finish()
    return path


def split(folder: Path) -> Path:
    made = rows()
    folder.mkdir()
    written(folder / "walk_0.mcap", made[: len(made) // 2])
    written(folder / "walk_1.mcap", made[len(made) // 2 :])
    return folder


def one_more_promised(writer: Writer) -> None:
    statistics = writer._Writer__statistics
    statistics.message_count += 1
    statistics.channel_message_counts[max(statistics.channel_message_counts)] += 1


def times_of_a_chunk_wrong(writer: Writer) -> None:
    index = writer._Writer__chunk_indices[-3]
    index.message_end_time = index.message_start_time


def with_a_broken_cloud(path: Path) -> Path:
    """Every message in a chunk of its own, and a byte of a cloud turned over, which nobody reads before `filter`."""
    in_chunks(path, rows(), 1)
    with open_container(path) as container:
        pieces = sorted(container._contents.pieces, key=lambda piece: piece.length)
    content = bytearray(path.read_bytes())
    content[pieces[-1].offset + pieces[-1].length // 2] ^= 0xFF
    path.write_bytes(content)
    return path


def all_but_two_late(n: int, log_ns: int, scan: Any) -> tuple[int, Any]:
    return log_ns if n < 2 else START_NS + 3 * S_NS + n * MS_NS, scan


def neighbours_swapped() -> list[Row]:
    """By less than the second that is worth a warning."""
    made = rows()
    return [row for first in range(0, len(made), 40) for row in made[first : first + 40][::-1]]


def late(row: Row) -> bool:
    return row[0] == LIDAR_TOPIC and row[1] < START_NS + S_NS


MAKERS: dict[str, Callable[[Path], Path]] = {
    "mcap": lambda folder: written(folder / "r.mcap", rows()),
    "bag": lambda folder: written(folder / "r.bag", rows(ros_version=1)),
    "db3": lambda folder: written(folder / "r.db3", rows()),
    "split": lambda folder: split(folder / "walk"),
    "small chunks": lambda folder: in_chunks(folder / "r.mcap", rows(), 1),
    "equal log times": lambda folder: written(
        folder / "r.mcap", rows(lambda n, log_ns, scan: (log_ns // 400_000_000 * 400_000_000, scan))
    ),
    "nearly all at once": lambda folder: written(folder / "r.mcap", sorted(rows(all_but_two_late), key=itemgetter(1))),
    "out of order": lambda folder: written(folder / "r.mcap", neighbours_swapped()),
    "a stray stamp": lambda folder: written(
        folder / "r.mcap", one(20, lambda log_ns, scan: stamped(scan, log_ns + 2 * HOUR_NS))
    ),
    "a stamp of 0": lambda folder: written(folder / "r.mcap", one(21, lambda log_ns, scan: stamped(scan, 0))),
    "not to be decoded": lambda folder: written(
        folder / "r.mcap", one(22, lambda log_ns, scan: RosEncoder(2).encode(scan, 0)[:200])
    ),
    "a broken cloud": lambda folder: with_a_broken_cloud(folder / "r.mcap"),
    "fewer than promised": lambda folder: in_chunks(folder / "r.mcap", rows(), 99_999, one_more_promised),
    "an index that is wrong": lambda folder: in_chunks(folder / "r.mcap", rows(), 99_999, times_of_a_chunk_wrong),
    "rows written late": lambda folder: written(folder / "r.db3", sorted(rows(), key=late)),
    "two clocks": lambda folder: written(
        folder / "r.mcap",
        rows(lambda n, log_ns, scan: (log_ns, stamped(scan, log_ns + 35 * MINUTE_NS)), beside_ns=-35 * MINUTE_NS),
    ),
}


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The recording of that name, with 32 clouds."""
    known: dict[str, Path] = {}

    def make(name: str) -> Path:
        if name not in known:
            known[name] = MAKERS[name](tmp_path_factory.mktemp("recordings"))
        return known[name]

    return make
