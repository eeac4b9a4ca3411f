from __future__ import annotations

import bz2
import json
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter

from quadlog.recordings.containers.open import open_container
from tests.lab import recordings


def chunk_indexes(path):
    with path.open("rb") as file:
        return make_reader(file).get_summary().chunk_indexes


def test_a_window_and_topics_read_only_the_chunks_they_need(tmp_path):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages)
    start_ns, end_ns = messages[20][1], messages[30][1]
    # Damage everything outside the window: a reader that touches it would report it.
    for chunk in chunk_indexes(path):
        if chunk.message_end_time < start_ns or chunk.message_start_time >= end_ns:
            recordings.flip(path, chunk.chunk_start_offset + chunk.chunk_length - 8)
    with open_container(path) as container:
        assert recordings.read(container, {"/a"}, start_ns, end_ns) == [m for m in messages[20:30] if m[0] == "/a"]
        assert container.losses == []


NO_SUMMARY = dict.fromkeys(("repeat_channels", "repeat_schemas", "use_statistics", "use_summary_offsets"), False)
NO_SUMMARY["index_types"] = IndexType.MESSAGE


def test_a_sound_file_without_summary_is_no_loss(tmp_path):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages, **NO_SUMMARY)
    with open_container(path) as container:
        assert recordings.read(container) == messages
        assert container.losses == []
        assert container.warnings == ["the file was written without a summary; the whole file was read to open it"]


@pytest.mark.parametrize("compression", CompressionType)
def test_without_summary_a_flipped_bit_of_a_length_costs_no_message(tmp_path, compression):
    """A chunk's record and the data in it have a length each, of which one is damaged."""
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages, compression=compression)
    begin = chunk_indexes(path)[2].chunk_start_offset
    sound = recordings.mcap(path, messages, compression=compression, **NO_SUMMARY).read_bytes()
    name_bytes = 0 if compression is CompressionType.NONE else len(compression.name)
    for place in (begin + 1, begin + 9 + 28 + 4 + name_bytes):
        for bit in range(0, 64, 3):
            data = bytearray(sound)
            data[place + bit // 8] ^= 1 << bit % 8
            path.write_bytes(bytes(data))
            with open_container(path) as container:
                assert recordings.read(container) == messages, (place, bit)


def test_channels_that_differ_in_nothing_are_one_and_encodings_are_passed_through(tmp_path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start("", "test")
        schemas = [
            0,
            writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", b""),
            *(writer.register_schema(f"std_msgs/{name}", "ros1msg", b"x") for name in ("String", "Int32")),
        ]
        for schema, encoding in zip(schemas, ("flatbuffer", "cdr", "ros1", "ros1"), strict=True):
            for _ in range(2):
                writer.add_message(writer.register_channel("/a", encoding, schema), 5, b"%d" % schema, 5)
        writer.finish()
    with open_container(path) as container:
        assert [(c.type_name, c.message_encoding, c.schema, c.count) for c in container.channels] == [
            ("", "flatbuffer", b"", 2),
            ("sensor_msgs/msg/Imu", "cdr", b"", 2),
            ("std_msgs/msg/String", "ros1", b"x", 2),
            ("std_msgs/msg/Int32", "ros1", b"x", 2),
        ]
        read = {(m.channel.type_name, bytes(m.payload)) for m in container.messages()}
        assert read == {(c.type_name, b"%d" % schema) for c, schema in zip(container.channels, schemas, strict=True)}


PACKERS = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "bz2": bz2.compress}


@pytest.mark.parametrize("compression", PACKERS)
def test_a_chunk_of_several_frames_is_read_whole_and_trailing_bytes_are_damage(tmp_path, compression):
    bodies = [recordings.message(1, b"one"), b"", recordings.message(2, b"two")]
    packed = b"".join(map(PACKERS[compression], bodies))
    size = len(b"".join(bodies))
    chunks = [recordings.chunk(size, compression.encode(), each) for each in (packed, packed + b"junk")]
    path = recordings.write_records(tmp_path / "a.mcap", recordings.channel(), *chunks)
    with open_container(path) as container:
        assert [bytes(message.payload) for message in container.messages()] == [b"one", b"two"]
        assert {loss.cause for loss in container.losses} == {"truncated", "damaged"}


def test_the_conformance_corpus_is_read_as_its_json_says(edge_cases):
    files = sorted((edge_cases / "mcap_conformance" / "files").rglob("*.mcap"))
    assert len(files) > 100
    for path in files:
        with open_container(path) as container:
            got = [(m.channel.topic, m.log_time_ns, bytes(m.payload)) for m in container.messages()]
            assert container.losses == [], path.name
        expected = path.with_suffix(".json")
        if expected.exists():
            assert got == messages_of(expected), path.name


def messages_of(path: Path):
    records = json.loads(path.read_text())["records"]
    channels = {dict(r["fields"])["id"]: dict(r["fields"])["topic"] for r in records if r["type"] == "Channel"}
    messages = [dict(r["fields"]) for r in records if r["type"] == "Message"]
    listed = [(channels[m["channel_id"]], int(m["log_time"]), bytes(map(int, m["data"]))) for m in messages]
    return sorted(listed, key=lambda message: message[1])
