from __future__ import annotations

import bz2
import json
import struct
from itertools import islice
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter

from quadlog.recordings.containers.mcap import McapFormat
from quadlog.recordings.containers.open import open_container


def chunk_indexes(path):
    with path.open("rb") as file:
        return make_reader(file).get_summary().chunk_indexes


def test_a_window_and_topics_read_only_the_chunks_they_need(tmp_path, recordings, flip):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages)
    start_ns, end_ns = messages[20][1], messages[30][1]
    # Damage everything outside the window: a reader that touches it would report it.
    for chunk in chunk_indexes(path):
        if chunk.message_end_time < start_ns or chunk.message_start_time >= end_ns:
            flip(path, chunk.chunk_start_offset + chunk.chunk_length - 8)
    with open_container(path) as container:
        assert recordings.read(container, {"/a"}, start_ns, end_ns) == [m for m in messages[20:30] if m[0] == "/a"]
        assert container.losses == []


def test_a_jump_inside_one_chunk_and_time_zero_are_named(tmp_path, recordings):
    messages = recordings.some(10)
    messages[5] = (messages[5][0], 0, b"zero")
    path = recordings.mcap(tmp_path / "a.mcap", messages, chunk_size=1 << 20)
    with open_container(path) as container:
        assert recordings.read(container)[0][2] == b"zero"
        assert any("goes back" in warning for warning in container.warnings)
        assert any("1 message logged at time 0" in warning for warning in container.warnings)


def test_messages_outside_chunks_are_recovered_from_a_truncated_file(tmp_path, recordings):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages, use_chunking=False)
    path.write_bytes(path.read_bytes()[:2000])
    with open_container(path) as container:
        got = recordings.read(container)
        assert 10 < len(got) < len(messages)
        assert got == messages[: len(got)]
        assert "truncated" in recordings.causes(container)


def test_a_flipped_byte_outside_chunks_is_seen_through_the_data_crc(tmp_path, recordings, flip):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages, use_chunking=False, enable_data_crcs=True)
    with open_container(path) as container:
        assert recordings.read(container) == messages
        assert container.losses == []
    flip(path, path.read_bytes().index(messages[30][2]) + 20)
    with open_container(path) as container:
        assert recordings.causes(container) == ["crc"]
        assert "60 messages" in container.losses[0].detail


@pytest.mark.parametrize(("offset", "cause"), [(3, "damaged"), (-3, "truncated"), (-100, "summary")])
def test_both_magics_and_the_summary_are_checked(tmp_path, recordings, flip, offset, cause):
    messages = recordings.some()
    path = flip(recordings.mcap(tmp_path / "a.mcap", messages), offset)
    with open_container(path) as container:
        assert recordings.read(container) == messages
        assert recordings.causes(container) == [cause]


NO_SUMMARY = dict.fromkeys(("repeat_channels", "repeat_schemas", "use_statistics", "use_summary_offsets"), False)
NO_SUMMARY["index_types"] = IndexType.MESSAGE


def test_a_sound_file_without_summary_is_no_loss(tmp_path, recordings):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages, **NO_SUMMARY)
    with open_container(path) as container:
        assert recordings.read(container) == messages
        assert container.losses == []
        assert container.warnings == ["the file was written without a summary; the whole file was read to open it"]


@pytest.mark.parametrize("compression", CompressionType)
def test_without_summary_a_flipped_bit_of_a_length_costs_no_message(tmp_path, recordings, compression):
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


@pytest.mark.parametrize("kind", [0x04, 0x07, 0x0F, 0x26, 0x86])
def test_without_summary_a_chunk_that_is_called_otherwise_costs_itself(tmp_path, recordings, kind):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages)
    chunk = chunk_indexes(path)[2]
    data = bytearray(recordings.mcap(path, messages, **NO_SUMMARY).read_bytes())
    data[chunk.chunk_start_offset] = kind
    path.write_bytes(bytes(data))
    with open_container(path) as container:
        inside = range(chunk.message_start_time, chunk.message_end_time + 1)
        assert recordings.read(container) == [each for each in messages if each[1] not in inside]
        assert recordings.causes(container) == ["damaged"]


@pytest.mark.parametrize(
    ("damage", "cause"),
    [
        (lambda data, begin: data.__setitem__(slice(at := data.index(b"zstd", begin), at + 4), b"brot"), "compression"),
        (lambda data, begin: struct.pack_into("<Q", data, begin + 9 + 16, 1 << 60), "too-large"),
    ],
)
def test_a_chunk_of_unknown_compression_or_size_costs_itself(tmp_path, recordings, damage, cause):
    """A size beyond the limit is refused before it is allocated."""
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages)
    chunk = chunk_indexes(path)[1]
    data = bytearray(path.read_bytes())
    damage(data, chunk.chunk_start_offset)
    path.write_bytes(bytes(data))
    with open_container(path) as container:
        got = recordings.read(container)
        lost = [m for m in messages if chunk.message_start_time <= m[1] <= chunk.message_end_time]
        assert got == [m for m in messages if m not in lost]
        (loss,) = container.losses
        assert (loss.cause, loss.count) == (cause, len(lost))


def test_a_wrong_count_in_the_summary_is_a_loss(tmp_path, recordings):
    messages = recordings.some(20)
    path = recordings.mcap(tmp_path / "a.mcap", messages, enable_crcs=False)
    # Statistics end with the map channel -> count; make total and channel 1 agree on one message too many.
    data = path.read_bytes()
    data = data.replace(struct.pack("<HQHQ", 1, 10, 2, 10), struct.pack("<HQHQ", 1, 11, 2, 10))
    data = data.replace(struct.pack("<QHI", 20, 1, 2), struct.pack("<QHI", 21, 1, 2))
    path.write_bytes(data)
    with open_container(path) as container:
        assert recordings.read(container) == messages
        (loss,) = container.losses
        assert (loss.cause, loss.topic, loss.count) == ("count", "/b", 1)


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
def test_a_chunk_of_several_frames_is_read_whole_and_trailing_bytes_are_damage(tmp_path, recordings, compression):
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


def test_overlapping_chunks_do_not_pile_up(tmp_path, recordings, monkeypatch):
    # Each chunk also holds a message of time zero: all chunks are open at once, their bodies must not be.
    monkeypatch.setattr("quadlog.recordings.containers.chunked_reader._KEPT_BYTES", 2000)
    messages = recordings.some()
    mixed = [each for message in messages for each in (("/a", 0, b"zero"), message)]
    path = recordings.mcap(tmp_path / "a.mcap", mixed)
    with open_container(path) as container:
        assert recordings.read(container) == sorted(mixed, key=lambda message: message[1])


def test_looking_at_the_first_messages_of_all_topics_loads_one_chunk(tmp_path, recordings, monkeypatch):
    loads, load = [], McapFormat.load
    monkeypatch.setattr(McapFormat, "load", lambda *each: loads.append(each[1].offset) or load(*each))
    path = recordings.mcap(tmp_path / "a.mcap", recordings.some())
    chunks = [each.chunk_start_offset for each in chunk_indexes(path)]
    with open_container(path) as container:
        for topic in ("/a", "/b", "/a"):
            assert len(list(islice(container.messages([topic]), 2))) == 2
        assert loads == chunks[:1]
        for expected in (chunks[1:], chunks):  # a pass that came to its end leaves nothing in memory
            loads.clear()
            assert recordings.read(container) == recordings.some()
            assert sorted(loads) == expected
