"""Writes a synthesized recording into any of three containers: the same messages at the same log times."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from quadlog.simulation.synthetic.recording import TF_STATIC_TOPIC, SynthesizedMessage
from quadlog.simulation.synthetic.ros_encoding import TYPE_NAMES, Definition, RosEncoder

# rosbag2's own words for: keep the last one, reliable, and for those who come later too.
LATCHED_QOS = (
    "[{history: 1, depth: 1, reliability: 1, durability: 1, deadline: {sec: 9223372036, nsec: 854775807}, "
    "lifespan: {sec: 9223372036, nsec: 854775807}, liveliness: 1, "
    "liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}, avoid_ros_namespace_conventions: false}]"
)


class McapRecording:
    """One .mcap: CDR payloads in zstd chunks, definitions as ros2msg."""

    ros_version: Literal[1, 2] = 2

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self._writer = McapWriter(self._file, compression=CompressionType.ZSTD)
        # A fixed name: the library's own carries its version, and with it the bytes would change.
        self._writer.start(profile="ros2", library="quadlog")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def add_topic(self, topic: str, type_name: str, definition: Definition) -> None:
        """Announce a topic before its first message, its type in ROS 2 spelling and the type's definition."""
        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", definition.text.encode())
        qos = {"offered_qos_profiles": LATCHED_QOS} if topic == TF_STATIC_TOPIC else {}
        self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[type_name], qos)

    def write(self, topic: str, log_time_ns: int, sequence: int, payload: bytes) -> None:
        """Append one message."""
        self._writer.add_message(self._channels[topic], log_time_ns, payload, log_time_ns, sequence)

    def close(self) -> None:
        """Finish the file; without this it is not a recording."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()

    def abandon(self) -> None:
        """Release the file unfinished."""
        self._file.close()


class BagRecording:
    """One ROS 1 .bag, uncompressed."""

    ros_version: Literal[1, 2] = 1

    def __init__(self, path: Path) -> None:
        # rosbags writes new files only.
        path.unlink(missing_ok=True)
        self._writer = BagWriter(path)
        self._writer.open()
        self._connections: dict[str, Connection] = {}

    def add_topic(self, topic: str, type_name: str, definition: Definition) -> None:
        """See McapRecording."""
        self._connections[topic] = self._writer.add_connection(
            topic,
            type_name,
            msgdef=definition.text,
            md5sum=definition.digest,
            latching=1 if topic == TF_STATIC_TOPIC else None,
        )

    def write(self, topic: str, log_time_ns: int, sequence: int, payload: bytes) -> None:
        """See McapRecording; a bag numbers no message outside its header."""
        self._writer.write(self._connections[topic], log_time_ns, payload)

    def close(self) -> None:
        """See McapRecording."""
        self._writer.close()

    def abandon(self) -> None:
        """See McapRecording."""
        if self._writer.bio is not None:
            self._writer.bio.close()


class Db3Recording:
    """One .db3 as rosbag2 (schema 4) keeps it, whole without its metadata.yaml."""

    ros_version: Literal[1, 2] = 2

    def __init__(self, path: Path) -> None:
        # No journal file: a recording that fails is deleted anyway.
        self._database = sqlite3.connect(path, isolation_level=None)
        self._database.execute("PRAGMA journal_mode = OFF")
        self._database.execute("PRAGMA synchronous = OFF")
        self._database.executescript(Sqlite3Writer.SQLITE_SCHEMA)
        self._database.execute("BEGIN")
        self._topics: dict[str, int] = {}
        self._types: set[str] = set()

    def add_topic(self, topic: str, type_name: str, definition: Definition) -> None:
        """See McapRecording."""
        if type_name not in self._types:
            self._types.add(type_name)
            row = (len(self._types), type_name, "ros2msg", definition.text, definition.digest)
            self._database.execute("INSERT INTO message_definitions VALUES (?, ?, ?, ?, ?)", row)
        self._topics[topic] = len(self._topics) + 1
        qos = LATCHED_QOS if topic == TF_STATIC_TOPIC else ""
        described = (self._topics[topic], topic, type_name, "cdr", qos, definition.digest)
        self._database.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)", described)

    def write(self, topic: str, log_time_ns: int, sequence: int, payload: bytes) -> None:
        """See McapRecording; sqlite keeps the order by its own row numbers."""
        row = (self._topics[topic], log_time_ns, payload)
        self._database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", row)

    def close(self) -> None:
        """See McapRecording."""
        self._database.execute("COMMIT")
        self._database.close()

    def abandon(self) -> None:
        """See McapRecording."""
        self._database.close()


RecordingWriter = McapRecording | BagRecording | Db3Recording
WRITERS: dict[str, type[RecordingWriter]] = {
    "mcap": McapRecording,
    "bag": BagRecording,
    "db3": Db3Recording,
}


def write_recording(writer: RecordingWriter, messages: Iterable[SynthesizedMessage]) -> dict[str, int]:
    """Write every message, close the recording, and say how many each topic has."""
    encoder = RosEncoder(writer.ros_version)
    counts: Counter[str] = Counter()
    try:
        for topic, log_time_ns, message in messages:
            if topic not in counts:
                type_name = TYPE_NAMES[type(message)]
                writer.add_topic(topic, type_name, encoder.definition(type_name))
            writer.write(topic, log_time_ns, counts[topic], encoder.encode(message, counts[topic]))
            counts[topic] += 1
    except BaseException:
        writer.abandon()
        raise
    writer.close()
    return dict(counts)
