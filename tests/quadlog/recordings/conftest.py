"""Builders of small recordings: written by the libraries that users' recorders share, not by quadlog."""

from __future__ import annotations

import os
import random
import resource
import sqlite3
import struct
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as BagWriter

Message = tuple[str, int, bytes]
BASE_NS = 1_700_000_000 * 10**9
TYPE_NAME = "std_msgs/msg/String"


def some_messages(count: int = 60, start_ns: int = BASE_NS) -> list[Message]:
    """Two topics in turn, 100 ms apart, payloads that say who they are and do not compress away."""
    noise = random.Random(count)
    return [
        ("/a" if i % 2 else "/b", start_ns + i * 10**8, b"\0\1\0\0" + b"%06d" % i + noise.randbytes(60))
        for i in range(count)
    ]


def build_mcap(path: Path, messages: Sequence[Message], **options: Any) -> Path:
    options = {"chunk_size": 600, "compression": CompressionType.ZSTD} | options
    with path.open("wb") as file:
        writer = McapWriter(file, **options)
        writer.start("ros2", "test")
        schema = writer.register_schema(TYPE_NAME, "ros2msg", b"string data")
        channels: dict[str, int] = {}
        for topic, t_ns, payload in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], t_ns, payload, t_ns)
        writer.finish()
    return path


def build_bag(path: Path, messages: Sequence[Message], compression: str = "", chunk_bytes: int = 600) -> Path:
    writer = BagWriter(path)
    writer.chunk_threshold = chunk_bytes
    if compression:
        writer.set_compression(BagWriter.CompressionFormat[compression.upper()])
    with writer:
        connections: dict[str, Any] = {}
        for topic, t_ns, payload in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, TYPE_NAME, msgdef="string data", md5sum="0" * 32)
            writer.write(connections[topic], t_ns, payload)
    return path


def build_db3(path: Path, messages: Sequence[Message], serialization: str = "cdr", index: bool = True) -> Path:
    connection = sqlite3.connect(path)
    fill_db3(connection, messages, serialization, index)
    connection.close()
    return path


def fill_db3(
    connection: sqlite3.Connection, messages: Sequence[Message], serialization: str = "cdr", index: bool = True
) -> None:
    """The tables that rosbag2_storage_sqlite3 makes."""
    connection.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
        " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,"
        " data BLOB NOT NULL);" + ("CREATE INDEX timestamp_idx ON messages (timestamp ASC);" if index else "")
    )
    topics = {topic: number for number, topic in enumerate(dict.fromkeys(topic for topic, _, _ in messages), 1)}
    for topic, number in topics.items():
        connection.execute("INSERT INTO topics VALUES (?, ?, ?, ?, '')", (number, topic, TYPE_NAME, serialization))
    connection.executemany(
        "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)",
        [(topics[topic], t_ns, payload) for topic, t_ns, payload in messages],
    )
    connection.commit()


def build(form: str, path: Path, messages: Sequence[Message], **options: Any) -> Path:
    """A recording of a form (`mcap-lz4`, `bag`, `db3-unindexed`, `split`) at exactly this path."""
    kind, _, option = form.partition("-")
    if kind == "split":
        path.mkdir()
        half = len(messages) // 2 or 1
        for number, part in enumerate((messages[:half], messages[half:])):
            build_mcap(path / f"walk_{number}.mcap", part, **options)
        return path
    if kind == "bag":
        return build_bag(path, messages, option, **options)
    if kind == "db3":
        return build_db3(path, messages, index=not option)
    if option == "loose":
        return build_mcap(path, messages, use_chunking=False, **options)
    return build_mcap(path, messages, **({"compression": CompressionType[option.upper()]} if option else {}) | options)


def unindex(path: Path) -> Path:
    """What a recorder of bags leaves that was killed: a header that points nowhere, no index behind the chunks."""
    data = bytearray(path.read_bytes())
    place = data.index(b"index_pos=") + len(b"index_pos=")
    (index_offset,) = struct.unpack_from("<Q", data, place)
    struct.pack_into("<Q", data, place, 0)
    path.write_bytes(bytes(data[:index_offset]))
    return path


def mcap_record(opcode: int, content: bytes, more: int = 0) -> bytes:
    """A record, or the beginning of one whose content goes on for so many bytes."""
    return struct.pack("<BQ", opcode, len(content) + more) + content


def mcap_text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def mcap_message(t_ns: int = 0, payload: bytes = b"", more: int = 0) -> bytes:
    return mcap_record(5, struct.pack("<HIQQ", 1, 0, t_ns, t_ns) + payload, more)


def mcap_channel(number: int = 1) -> bytes:
    return mcap_record(4, struct.pack("<HH", number, 0) + mcap_text(b"/t%d" % number) + mcap_text(b"cdr") + bytes(4))


def mcap_chunk(size: int, compression: bytes, packed: bytes) -> bytes:
    """A chunk of log times 0 to 1 s without a checksum; size: what it declares to hold."""
    head = struct.pack("<QQQI", 0, 10**9, size, 0) + mcap_text(compression)
    return mcap_record(6, head + struct.pack("<Q", len(packed)) + packed)


def write_mcap_records(path: Path, *records: bytes) -> Path:
    """A file of these records without a summary, whose data section ends as it should."""
    path.write_bytes(b"".join([b"\x89MCAP0\r\n", *records, mcap_record(15, bytes(4))]))
    return path


class Recordings:
    """The builders, and how to compare what they wrote with what a container gives back."""

    base_ns = BASE_NS
    type_name = TYPE_NAME
    some = staticmethod(some_messages)
    build = staticmethod(build)
    unindex = staticmethod(unindex)
    mcap = staticmethod(build_mcap)
    bag = staticmethod(build_bag)
    db3 = staticmethod(build_db3)
    fill_db3 = staticmethod(fill_db3)
    record = staticmethod(mcap_record)
    text = staticmethod(mcap_text)
    message = staticmethod(mcap_message)
    channel = staticmethod(mcap_channel)
    chunk = staticmethod(mcap_chunk)
    write_records = staticmethod(write_mcap_records)

    @staticmethod
    def read(container: Any, *arguments: Any) -> list[Message]:
        return [Recordings.read_one(message) for message in container.messages(*arguments)]

    @staticmethod
    def read_one(message: Any) -> Message:
        return message.channel.topic, message.log_time_ns, bytes(message.payload)

    @staticmethod
    def causes(container: Any) -> list[str]:
        return [loss.cause for loss in container.losses]


@pytest.fixture(scope="session")
def recordings() -> type[Recordings]:
    return Recordings


@pytest.fixture(scope="session")
def edge_cases() -> Path:
    folder = os.environ.get("QUADLOG_DATASETS")
    if not folder:
        pytest.skip("QUADLOG_DATASETS is not set")
    return Path(folder) / "edge_cases"


@pytest.fixture
def limited() -> Iterator[Callable[[int, int], None]]:
    """Sets a soft limit of this process, for the test."""
    before: dict[int, tuple[int, int]] = {}

    def limit(which: int, most: int) -> None:
        before[which] = resource.getrlimit(which)
        resource.setrlimit(which, (most, before[which][1]))

    yield limit
    for which, limits in before.items():
        resource.setrlimit(which, limits)


@pytest.fixture
def flip() -> Callable[[Path, int], Path]:
    """Turns the bits of one byte of a file over."""

    def flip_byte(path: Path, offset: int) -> Path:
        data = bytearray(path.read_bytes())
        data[offset] ^= 0xFF
        path.write_bytes(bytes(data))
        return path

    return flip_byte
