from __future__ import annotations

import bz2
import json
import struct
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import IndexType
from mcap.writer import Writer as McapWriter

from quadlog.recordings.containers.open import open_container


def chunk_indexes(path):
    with path.open("rb") as file:
        return make_reader(file).get_summary().chunk_indexes


def replace_in(path, old, new):
    data = path.read_bytes()
    assert len(old) == len(new)
    assert old in data
    path.write_bytes(data.replace(old, new))


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


def test_a_file_written_without_summary_says_so(tmp_path, recordings):
    messages = recordings.some()
    options = {"index_types": IndexType.NONE, "repeat_channels": False, "repeat_schemas": False}
    path = recordings.mcap(tmp_path / "a.mcap", messages, use_statistics=False, use_summary_offsets=False, **options)
    with open_container(path) as container:
        assert recordings.read(container) == messages
        assert recordings.causes(container) == ["summary"]


def test_one_chunk_of_unknown_compression_costs_itself(tmp_path, recordings):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages)
    chunk = chunk_indexes(path)[1]
    data = bytearray(path.read_bytes())
    place = data.index(b"zstd", chunk.chunk_start_offset)
    data[place : place + 4] = b"brot"
    path.write_bytes(bytes(data))
    with open_container(path) as container:
        got = recordings.read(container)
        assert recordings.causes(container) == ["compression"]
        assert "'brot'" in container.losses[0].detail
        assert container.losses[0].count == len(messages) - len(got) > 0


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


def test_one_topic_with_two_types_is_two_channels(tmp_path, recordings):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start("ros1", "test")
        for name in ("std_msgs/String", "std_msgs/Int32"):
            schema = writer.register_schema(name, "ros1msg", b"x")
            for _ in range(2):
                channel = writer.register_channel("/a", "ros1", schema)
                writer.add_message(channel, 5, name.encode(), 5)
        writer.finish()
    with open_container(path) as container:
        assert [(c.type_name, c.count) for c in container.channels] == [
            ("std_msgs/msg/String", 2),
            ("std_msgs/msg/Int32", 2),
        ]
        assert {(m.channel.type_name, bytes(m.payload)) for m in container.messages()} == {
            ("std_msgs/msg/String", b"std_msgs/String"),
            ("std_msgs/msg/Int32", b"std_msgs/Int32"),
        }


def test_encodings_and_empty_schemas_are_passed_through(tmp_path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start("", "test")
        writer.add_message(writer.register_channel("/none", "flatbuffer", 0), 5, b"x", 5)
        empty = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", b"")
        writer.add_message(writer.register_channel("/empty", "cdr", empty), 6, b"y", 6)
        writer.finish()
    with open_container(path) as container:
        found = [(c.topic, c.type_name, c.message_encoding, c.schema) for c in container.channels]
        assert found == [("/none", "", "flatbuffer", b""), ("/empty", "sensor_msgs/msg/Imu", "cdr", b"")]
        assert len(list(container.messages())) == 2


def chunk_record(body, compression, packed):
    """One MCAP chunk with no times, no checksum and this content."""
    content = struct.pack("<QQQII", 0, 0, len(body), 0, len(compression)) + compression.encode()
    content += struct.pack("<Q", len(packed)) + packed
    return struct.pack("<BQ", 6, len(content)) + content


def message_record(payload=b"", channel=1, t_ns=0):
    content = struct.pack("<HIQQ", channel, 0, t_ns, t_ns) + payload
    return struct.pack("<BQ", 5, len(content)) + content


def definitions(topic="/a"):
    texts = b"".join(struct.pack("<I", len(text)) + text for text in (topic.encode(), b"ros1", b""))
    return struct.pack("<BQHH", 4, 4 + len(texts), 1, 0) + texts


def write_chunks(path, *chunks):
    """An MCAP file of these records without a summary, whose data section ends as it should."""
    path.write_bytes(b"".join([b"\x89MCAP0\r\n", definitions(), *chunks, struct.pack("<BQI", 15, 4, 0)]))
    return path


PACKERS = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "bz2": bz2.compress}


@pytest.mark.parametrize("compression", PACKERS)
def test_a_chunk_of_several_frames_is_read_to_its_end_and_what_follows_them_is_damage(tmp_path, compression):
    bodies = [message_record(b"one", t_ns=1), b"", message_record(b"two", t_ns=2)]
    packed = b"".join(map(PACKERS[compression], bodies))
    whole, longer = (chunk_record(b"".join(bodies), compression, each) for each in (packed, packed + b"junk"))
    with open_container(write_chunks(tmp_path / "a.mcap", whole, longer)) as container:
        assert [bytes(message.payload) for message in container.messages()] == [b"one", b"two"]
        assert {loss.cause for loss in container.losses} == {"truncated", "damaged"}


def test_a_declared_size_beyond_the_limit_is_refused_before_it_is_allocated(tmp_path, recordings):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages)
    chunk = chunk_indexes(path)[0]
    data = bytearray(path.read_bytes())
    struct.pack_into("<Q", data, chunk.chunk_start_offset + 9 + 16, 1 << 60)
    path.write_bytes(bytes(data))
    with open_container(path) as container:
        got = recordings.read(container)
        assert recordings.causes(container) == ["too-large"]
        assert got == [m for m in messages if m[1] > chunk.message_end_time]


def test_the_conformance_corpus_is_read_as_its_json_says(edge_cases):
    files = sorted((edge_cases / "mcap_conformance" / "files").rglob("*.mcap"))
    assert len(files) > 100
    for path in files:
        with open_container(path) as container:
            got = [(m.channel.topic, m.log_time_ns, bytes(m.payload)) for m in container.messages()]
            assert {loss.cause for loss in container.losses} <= {"summary"}, path.name
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
