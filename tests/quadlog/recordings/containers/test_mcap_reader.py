from __future__ import annotations

import bz2
import io
import json
import struct
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter

from quadlog.errors import NothingReadable
from quadlog.recordings.containers.mcap import open_mcap


def chunk_indexes(path):
    with path.open("rb") as file:
        return make_reader(file).get_summary().chunk_indexes


def replace_in(path, old, new):
    data = path.read_bytes()
    assert len(old) == len(new)
    assert old in data
    path.write_bytes(data.replace(old, new))


@pytest.mark.parametrize("compression", list(CompressionType))
def test_every_message_comes_back_in_order(tmp_path, recordings, compression):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages, compression=compression)
    with open_mcap(path) as container:
        assert recordings.read(container) == messages
        assert (container.losses, container.warnings) == ([], [])
        assert [(c.topic, c.type_name, c.message_encoding, c.count) for c in container.channels] == [
            ("/b", "std_msgs/msg/String", "cdr", 30),
            ("/a", "std_msgs/msg/String", "cdr", 30),
        ]
        assert container.span_ns == (messages[0][1], messages[-1][1])


def test_a_window_and_topics_read_only_the_chunks_they_need(tmp_path, recordings, flip):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages)
    start_ns, end_ns = messages[20][1], messages[30][1]
    # Damage everything outside the window: a reader that touches it would report it.
    for chunk in chunk_indexes(path):
        if chunk.message_end_time < start_ns or chunk.message_start_time >= end_ns:
            flip(path, chunk.chunk_start_offset + chunk.chunk_length - 8)
    with open_mcap(path) as container:
        assert recordings.read(container, {"/a"}, start_ns, end_ns) == [m for m in messages[20:30] if m[0] == "/a"]
        assert container.losses == []


def test_unsorted_messages_are_sorted_ties_keep_file_order_and_the_jump_is_named(tmp_path, recordings):
    ordered = recordings.some(40)
    messages = ordered[20:] + ordered[:20] + [(t, ordered[5][1], b"tie%d" % i) for i, t in enumerate(["/a", "/b"])]
    path = recordings.mcap(tmp_path / "a.mcap", messages)
    with open_mcap(path) as container:
        got = recordings.read(container)
        assert got == sorted(messages, key=lambda message: message[1])
        # In file order the clock falls from ordered[39] to ordered[0]: 3.9 s.
        assert "goes back" in container.warnings[0]
        assert "3.900 s" in container.warnings[0]
        with path.open("rb") as file:
            theirs = [(c.topic, m.log_time, m.data) for _, c, m in make_reader(file).iter_messages()]
        assert got == theirs


def test_a_jump_inside_one_chunk_and_time_zero_are_named(tmp_path, recordings):
    messages = recordings.some(10)
    messages[5] = (messages[5][0], 0, b"zero")
    path = recordings.mcap(tmp_path / "a.mcap", messages, chunk_size=1 << 20)
    with open_mcap(path) as container:
        assert recordings.read(container)[0][2] == b"zero"
        assert any("goes back" in warning for warning in container.warnings)
        assert any("1 message logged at time 0" in warning for warning in container.warnings)


def test_a_flipped_byte_costs_its_chunk_only_and_is_counted_once(tmp_path, recordings, flip):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages, compression=CompressionType.NONE)
    chunk = chunk_indexes(path)[2]
    flip(path, chunk.chunk_start_offset + chunk.chunk_length - 10)
    lost = [m for m in messages if chunk.message_start_time <= m[1] <= chunk.message_end_time]
    with open_mcap(path) as container:
        expected = [m for m in messages if m not in lost]
        assert recordings.read(container) == expected
        assert recordings.read(container) == expected
        (loss,) = container.losses
        assert (loss.cause, loss.count) == ("crc", len(lost))
        assert f"offset {chunk.chunk_start_offset}" in loss.detail


def test_a_message_that_became_another_record_costs_its_chunk(tmp_path, recordings):
    """Where the writer computed no checksums."""
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages, compression=CompressionType.NONE, enable_crcs=False)
    data = bytearray(path.read_bytes())
    first = chunk_indexes(path)[2].chunk_start_offset + 9 + 8 + 8 + 8 + 4 + 4 + 8
    opcode, at = data[first], first
    while opcode != 5:
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        opcode = data[at]
    data[at] = 7
    path.write_bytes(bytes(data))
    with open_mcap(path) as container:
        got = recordings.read(container)
        assert got == [message for message in messages if message in got]
        assert "which may have been a message" in container.losses[-1].detail
        assert sum(loss.count for loss in container.losses) == len(messages) - len(got) > 0


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_flipped_byte_in_compressed_data_is_seen(tmp_path, recordings, flip, compression):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages, compression=compression)
    chunk = chunk_indexes(path)[1]
    flip(path, chunk.chunk_start_offset + chunk.chunk_length // 2)
    with open_mcap(path) as container:
        got = recordings.read(container)
        assert all(message in messages for message in got)
        assert sum(loss.count for loss in container.losses) == len(messages) - len(got) > 0


def test_a_truncated_file_gives_all_whole_chunks_and_says_until_when(tmp_path, recordings):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages)
    chunk = chunk_indexes(path)[3]
    cut = chunk.chunk_start_offset + chunk.chunk_length // 2
    path.write_bytes(path.read_bytes()[:cut])
    with open_mcap(path) as container:
        got = recordings.read(container)
        assert got == [m for m in messages if m[1] < chunk.message_start_time]
        assert recordings.causes(container) == ["truncated", "truncated"]
        assert f"{cut - chunk.chunk_start_offset} bytes after offset {chunk.chunk_start_offset}" in (
            container.losses[1].detail
        )
        # 1.7e9 s is 2023-11-14T22:13:20Z.
        assert f"2023-11-14T22:13:{20 + (got[-1][1] - recordings.base_ns) / 1e9:06.3f}Z" in container.losses[1].detail
        assert container.span_ns == (got[0][1], got[-1][1])
        assert sum(channel.count for channel in container.channels) == len(got)


def test_a_tail_of_zeros_after_a_power_cut_is_a_truncation(tmp_path, recordings):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages)
    chunk = chunk_indexes(path)[3]
    path.write_bytes(path.read_bytes()[: chunk.chunk_start_offset] + bytes(5000))
    with open_mcap(path) as container:
        assert recordings.read(container) == [m for m in messages if m[1] < chunk.message_start_time]
        assert "5000 bytes after offset" in container.losses[-1].detail


def test_messages_outside_chunks_are_recovered_from_a_truncated_file(tmp_path, recordings):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages, use_chunking=False)
    path.write_bytes(path.read_bytes()[:2000])
    with open_mcap(path) as container:
        got = recordings.read(container)
        assert 10 < len(got) < len(messages)
        assert got == messages[: len(got)]
        assert "truncated" in recordings.causes(container)


def test_a_flipped_byte_outside_chunks_is_seen_through_the_data_crc(tmp_path, recordings, flip):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages, use_chunking=False, enable_data_crcs=True)
    with open_mcap(path) as container:
        assert recordings.read(container) == messages
        assert container.losses == []
    flip(path, path.read_bytes().index(messages[30][2]) + 20)
    with open_mcap(path) as container:
        assert recordings.causes(container) == ["crc"]
        assert "60 messages" in container.losses[0].detail


def test_a_damaged_summary_is_not_believed(tmp_path, recordings, flip):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages)
    flip(path, path.stat().st_size - 100)
    with open_mcap(path) as container:
        assert recordings.read(container) == messages
        assert recordings.causes(container) == ["summary"]


def test_both_magics_are_checked(tmp_path, recordings, flip):
    messages = recordings.some()
    for offset, cause in ((3, "damaged"), (-3, "truncated")):
        path = recordings.mcap(tmp_path / "a.mcap", messages)
        flip(path, offset)
        with open_mcap(path) as container:
            assert recordings.read(container) == messages
            assert recordings.causes(container) == [cause]


def test_a_file_written_without_summary_says_so(tmp_path, recordings):
    messages = recordings.some()
    options = {"index_types": IndexType.NONE, "repeat_channels": False, "repeat_schemas": False}
    path = recordings.mcap(tmp_path / "a.mcap", messages, use_statistics=False, use_summary_offsets=False, **options)
    with open_mcap(path) as container:
        assert recordings.read(container) == messages
        assert recordings.causes(container) == ["summary"]


def test_an_unknown_compression_is_refused_by_name(tmp_path, recordings):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages, enable_crcs=False)
    replace_in(path, struct.pack("<I", 4) + b"zstd", struct.pack("<I", 4) + b"brot")
    with pytest.raises(NothingReadable, match="'brot'"):
        open_mcap(path)


def test_one_chunk_of_unknown_compression_costs_itself(tmp_path, recordings):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages)
    chunk = chunk_indexes(path)[1]
    data = bytearray(path.read_bytes())
    place = data.index(b"zstd", chunk.chunk_start_offset)
    data[place : place + 4] = b"brot"
    path.write_bytes(bytes(data))
    with open_mcap(path) as container:
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
    with open_mcap(path) as container:
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
    with open_mcap(path) as container:
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
    with open_mcap(path) as container:
        found = [(c.topic, c.type_name, c.message_encoding, c.schema) for c in container.channels]
        assert found == [("/none", "", "flatbuffer", b""), ("/empty", "sensor_msgs/msg/Imu", "cdr", b"")]
        assert len(list(container.messages())) == 2


def test_nothing_but_a_header_is_nothing_readable(tmp_path, recordings):
    path = recordings.mcap(tmp_path / "a.mcap", recordings.some())
    path.write_bytes(path.read_bytes()[:30])
    with pytest.raises(NothingReadable, match="offset"):
        open_mcap(path)


def test_every_chunk_damaged_is_nothing_readable(tmp_path, recordings, flip):
    path = recordings.mcap(tmp_path / "a.mcap", recordings.some(), compression=CompressionType.NONE)
    for chunk in chunk_indexes(path):
        flip(path, chunk.chunk_start_offset + chunk.chunk_length - 8)
    with open_mcap(path) as container, pytest.raises(NothingReadable, match="checksum"):
        list(container.messages())


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
    with open_mcap(write_chunks(tmp_path / "a.mcap", whole, longer)) as container:
        assert [bytes(message.payload) for message in container.messages()] == [b"one", b"two"]
        assert {loss.cause for loss in container.losses} == {"truncated", "damaged"}


def test_a_declared_size_beyond_the_limit_is_refused_before_it_is_allocated(tmp_path, recordings):
    messages = recordings.some()
    path = recordings.mcap(tmp_path / "a.mcap", messages)
    chunk = chunk_indexes(path)[0]
    data = bytearray(path.read_bytes())
    struct.pack_into("<Q", data, chunk.chunk_start_offset + 9 + 16, 1 << 60)
    path.write_bytes(bytes(data))
    with open_mcap(path) as container:
        got = recordings.read(container)
        assert recordings.causes(container) == ["too-large"]
        assert got == [m for m in messages if m[1] > chunk.message_end_time]


def test_the_conformance_corpus_is_read_as_its_json_says(edge_cases):
    files = sorted((edge_cases / "mcap_conformance" / "files").rglob("*.mcap"))
    assert len(files) > 100
    for path in files:
        with open_mcap(path) as container:
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
    with open_mcap(path) as container:
        assert recordings.read(container) == sorted(mixed, key=lambda message: message[1])


def test_it_reads_what_the_mcap_library_reads(tmp_path, recordings):
    messages = [(f"/{i % 7}", recordings.base_ns + (i * 7919) % 1000, b"%d" % i) for i in range(500)]
    path = recordings.mcap(tmp_path / "a.mcap", messages, chunk_size=300)
    reader = make_reader(io.BytesIO(path.read_bytes()))
    start_ns, end_ns = recordings.base_ns + 200, recordings.base_ns + 700
    theirs = [
        (channel.topic, message.log_time, message.data)
        for _, channel, message in reader.iter_messages(["/1", "/2"], starting_at=start_ns, ending_before=end_ns)
    ]
    with open_mcap(path) as container:
        assert recordings.read(container, {"/1", "/2"}, start_ns, end_ns) == theirs
