"""Small recordings, written by the libraries that users' recorders share, not by quadlog; `make fuzz` damages them."""

from __future__ import annotations

import random
import sqlite3
import struct
from collections.abc import Container, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadlog.simulation.synthetic.ros_encoding import LINKTRACK, RosEncoder
from tests.lab.messages import store_of

Message = tuple[str, int, bytes]
BASE_NS = 1_700_000_000 * 10**9
TYPE_NAME = "std_msgs/msg/String"
Types = Mapping[str, tuple[str, str, str]]
"""What a topic holds, where it is no String: name of the type, definition, digest."""
_STRING = (TYPE_NAME, "string data", "0" * 32)
STRINGS: Types = MappingProxyType({})


def some(count: int = 60, start_ns: int = BASE_NS) -> list[Message]:
    """Two topics in turn, 100 ms apart, payloads that say who they are and do not compress away."""
    noise = random.Random(count)
    return [
        ("/a" if i % 2 else "/b", start_ns + i * 10**8, b"\0\1\0\0" + b"%06d" % i + noise.randbytes(60))
        for i in range(count)
    ]


def mcap(path: Path, messages: Iterable[Message], types: Types = STRINGS, **options: Any) -> Path:
    """Options are those of `mcap_of`."""
    return mcap_of(
        path, ((topic, t_ns, *types.get(topic, _STRING)[:2], payload) for topic, t_ns, payload in messages), **options
    )


def mcap_of(
    path: Path, rows: Iterable[tuple[str, int, str, str, bytes]], before_end: Any = lambda writer: None, **options: Any
) -> Path:
    """Topic, log time, type, definition and payload. Options are those of the library's Writer, given to before_end."""
    with path.open("wb") as file:
        writer = McapWriter(file, **{"chunk_size": 600, "compression": CompressionType.ZSTD} | options)
        writer.start("ros2", "test")
        schema = cache(lambda name, text: writer.register_schema(name, "ros2msg", text.encode()))
        channel = cache(lambda topic, name, text: writer.register_channel(topic, "cdr", schema(name, text)))
        for *described, payload in rows:
            topic, t_ns, name, text = described
            writer.add_message(channel(topic, name, text), t_ns, payload, t_ns)
        before_end(writer)
        writer.finish()
    return path


def bag(
    path: Path, messages: Sequence[Message], compression: str = "", chunk_bytes: int = 600, types: Types = STRINGS
) -> Path:
    writer = BagWriter(path)
    writer.chunk_threshold = chunk_bytes
    if compression:
        writer.set_compression(BagWriter.CompressionFormat[compression.upper()])
    with writer:
        connections: dict[str, Any] = {}
        for topic, t_ns, payload in messages:
            if topic not in connections:
                name, definition, digest = types.get(topic, _STRING)
                connections[topic] = writer.add_connection(topic, name, msgdef=definition, md5sum=digest)
            writer.write(connections[topic], t_ns, payload)
    return path


def db3(
    path: Path, messages: Sequence[Message], serialization: str = "cdr", index: bool = True, types: Types = STRINGS
) -> Path:
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA synchronous = OFF")
    fill_db3(connection, messages, serialization, index, types)
    connection.close()
    return path


def fill_db3(
    connection: sqlite3.Connection,
    messages: Sequence[Message],
    serialization: str = "cdr",
    index: bool = True,
    types: Types = STRINGS,
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
        name, _, _ = types.get(topic, _STRING)
        connection.execute("INSERT INTO topics VALUES (?, ?, ?, ?, '')", (number, topic, name, serialization))
    connection.executemany(
        "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)",
        [(topics[topic], t_ns, payload) for topic, t_ns, payload in messages],
    )
    connection.commit()


Row = tuple[str, int, str, bytes]
"""Topic, log time, type and CDR payload."""


@cache
def _definition(name: str) -> str:
    """LinkTrack's frames carry a header, as the encoder writes them; of an unknown type there is none."""
    store = store_of("little")
    if name == LINKTRACK:
        return RosEncoder().definition(name)
    return store.generate_msgdef(name, ros_version=2)[0] if name in store.fielddefs else ""


@cache
def _store(ros: Stores, name: str) -> Any:
    store = get_typestore(ros)
    types = get_types_from_msg(_definition(name), name)
    store.register({each: fields for each, fields in types.items() if each not in store.fielddefs})
    return store


def in_ros1(name: str, payload: bytes) -> tuple[bytes, str, str]:
    """A CDR payload as ROS 1 has it, and the definition and digest that a bag embeds."""
    converted = _store(Stores.ROS2_HUMBLE, name).cdr_to_ros1(payload, name)
    return bytes(converted), *_store(Stores.ROS1_NOETIC, name).generate_msgdef(name, ros_version=1)


def written(path: Path, rows: Sequence[Row], defined: Container[str] | None = None, **options: Any) -> Path:
    """A recording in the container that its extension names, MCAP without one; defined: types with a definition."""
    if path.suffix not in (".bag", ".db3"):
        text = {name: _definition(name) if defined is None or name in defined else "" for _, _, name, _ in rows}
        described = ((topic, t_ns, name, text[name], payload) for topic, t_ns, name, payload in rows)
        return mcap_of(path, described, **{"chunk_size": 1 << 20} | options)
    messages, types = [], {}
    for topic, t_ns, name, cdr in rows:
        payload, *described = in_ros1(name, cdr) if path.suffix == ".bag" else (cdr, "", "")
        types[topic] = (name, *described)
        messages.append((topic, t_ns, payload))
    return {".bag": bag, ".db3": db3}[path.suffix](path, messages, types=types)


def build(form: str, path: Path, messages: Sequence[Message], **options: Any) -> Path:
    """A recording of a form (`mcap-lz4`, `bag`, `db3-unindexed`, `split`) at exactly this path."""
    kind, _, option = form.partition("-")
    if kind == "split":
        path.mkdir()
        half = len(messages) // 2 or 1
        for number, part in enumerate((messages[:half], messages[half:])):
            mcap(path / f"walk_{number}.mcap", part, **options)
        return path
    if kind == "bag":
        return bag(path, messages, option, **options)
    if kind == "db3":
        return db3(path, messages, index=not option)
    if option == "loose":
        return mcap(path, messages, use_chunking=False, **options)
    return mcap(path, messages, **({"compression": CompressionType[option.upper()]} if option else {}) | options)


def unindex(path: Path) -> Path:
    """What a recorder of bags leaves that was killed: a header that points nowhere, no index behind the chunks."""
    data = bytearray(path.read_bytes())
    place = data.index(b"index_pos=") + len(b"index_pos=")
    (index_offset,) = struct.unpack_from("<Q", data, place)
    struct.pack_into("<Q", data, place, 0)
    path.write_bytes(bytes(data[:index_offset]))
    return path


def record(opcode: int, content: bytes, more: int = 0) -> bytes:
    """A record, or the beginning of one whose content goes on for so many bytes."""
    return struct.pack("<BQ", opcode, len(content) + more) + content


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def message(t_ns: int = 0, payload: bytes = b"", more: int = 0) -> bytes:
    return record(5, struct.pack("<HIQQ", 1, 0, t_ns, t_ns) + payload, more)


def channel(number: int = 1) -> bytes:
    return record(4, struct.pack("<HH", number, 0) + text(b"/t%d" % number) + text(b"cdr") + bytes(4))


def chunk(size: int, compression: bytes, packed: bytes) -> bytes:
    """A chunk of log times 0 to 1 s without a checksum; size: what it declares to hold."""
    head = struct.pack("<QQQI", 0, 10**9, size, 0) + text(compression)
    return record(6, head + struct.pack("<Q", len(packed)) + packed)


def write_records(path: Path, *records: bytes) -> Path:
    """A file of these records without a summary, whose data section ends as it should."""
    path.write_bytes(b"".join([b"\x89MCAP0\r\n", *records, record(15, bytes(4))]))
    return path


def bag_record(data: bytes, **fields: bytes) -> bytes:
    """A record of a bag; fields: those of its header, as `op=b"\\2"`."""
    parts = [name.encode() + b"=" + value for name, value in fields.items()]
    header = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def bag_message(payload: bytes = b"") -> bytes:
    """A message of a bag at time 0, of the connection that `bag_of` has."""
    return bag_record(payload, op=b"\2", conn=bytes(4), time=bytes(8))


def bag_of(path: Path, compression: bytes, packed: bytes, size: int, count: int) -> Path:
    """A bag without an index, of so many equal chunks of messages of one connection."""
    names = {"topic": b"/a", "type": b"std_msgs/String", "md5sum": b"0" * 32, "message_definition": b"string data"}
    inner = bag_record(b"", **names)
    connection = bag_record(inner[4:-4], op=b"\7", conn=bytes(4), topic=b"/a")
    head = bag_record(b" " * 4000, op=b"\3", index_pos=bytes(8), conn_count=bytes(4), chunk_count=bytes(4))
    chunk = bag_record(packed, op=b"\5", compression=compression, size=struct.pack("<I", size))
    path.write_bytes(b"#ROSBAG V2.0\n" + head + connection + chunk * count)
    return path


def read(container: Any, *arguments: Any) -> list[Message]:
    """What a container gives back, to be compared with what was written."""
    return [read_one(message) for message in container.messages(*arguments)]


def read_one(message: Any) -> Message:
    return message.channel.topic, message.log_time_ns, bytes(message.payload)


def causes(container: Any) -> list[str]:
    return [loss.cause for loss in container.losses]


def flip(path: Path, offset: int) -> Path:
    """The file with the bits of one byte turned over."""
    data = bytearray(path.read_bytes())
    data[offset] ^= 0xFF
    path.write_bytes(bytes(data))
    return path
