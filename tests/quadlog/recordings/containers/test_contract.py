"""What holds for recordings of every form, sound or damaged, against what was written, and what is no recording."""

from __future__ import annotations

import gzip
import os
from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.rosbag1 import Reader

from fuzzing.edits import edited
from quadlog.errors import NotARecording, NothingReadable, QuadlogError, RecordingNotFound
from quadlog.recordings.containers import chunked
from quadlog.recordings.containers.open import open_container
from quadlog.storage import byte_source
from tests.lab import recordings

MCAPS = ["mcap", "mcap-lz4", "mcap-none"]
FORMS = [*MCAPS, "mcap-loose", "bag", "bag-lz4", "bag-bz2", "db3", "db3-unindexed", "split"]
SCHEMAS = {"bag": ("ros1", "ros1msg", b"string data"), "db3": ("cdr", "", b"")}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("in_order", [True, False])
def test_messages_come_in_order_of_time_ties_in_file_order(tmp_path, form, in_order):
    """Whatever the file's name; of a window and topics no others. A clock that goes back is named."""
    messages = recordings.some(40)
    if not in_order:
        # Right before the ties come others of their chunk, so that it is open when they are due.
        t_ns = messages[5][1]
        late = [(topic, each_ns, b"%d" % each_ns) for each_ns in (t_ns - 1, t_ns) for topic in ("/a", "/b")]
        messages = messages[20:] + messages[:20] + late
    expected = sorted(messages, key=lambda message: message[1])
    start_ns, end_ns = expected[10][1], expected[30][1]
    with open_container(recordings.build(form, tmp_path / "log.txt", messages)) as container:
        assert recordings.read(container) == expected
        within = [m for m in expected if m[0] == "/a" and start_ns <= m[1] < end_ns]
        assert recordings.read(container, {"/a"}, start_ns, end_ns) == within
        assert container.span_ns == (expected[0][1], expected[-1][1])
        schema = SCHEMAS.get(form.partition("-")[0], ("cdr", "ros2msg", b"string data"))
        each = recordings.TYPE_NAME, *schema, len(messages) // 2
        assert {tuple(getattr(c, name) for name in c.__slots__) for c in container.channels} == {
            ("/a", *each),
            ("/b", *each),
        }
        assert container.losses == []
        if in_order:
            assert container.warnings == []
        elif form == "split":
            assert "walk_1.mcap starts 3.700 s before the files ahead of it end" in container.warnings[0]
        else:
            # In file order the clock falls from the last message to the first.
            assert "goes back" in container.warnings[0]
            assert "3.900 s" in container.warnings[0]


@pytest.mark.parametrize("form", ["mcap", "bag-bz2"])
@pytest.mark.parametrize("room", [True, False])
def test_chunks_that_all_overlap_are_kept_on_disk_as_far_as_there_is_room(tmp_path, monkeypatch, form, room):
    """Each begins with a message of the first instant, which is given at once, the others at their time."""
    monkeypatch.setattr(chunked, "_HELD_BYTES", 1500)
    if not room:
        monkeypatch.setattr(byte_source.shutil, "disk_usage", lambda _: type("Free", (), {"free": 3000}))
    messages = recordings.some(120)
    messages = [(topic, messages[0][1] if i % 6 == 0 else t_ns, data) for i, (topic, t_ns, data) in enumerate(messages)]
    expected = sorted(messages, key=lambda message: message[1])
    with open_container(recordings.build(form, tmp_path / "walk", messages)) as container:
        for _ in range(2):
            got = recordings.read(container)
            assert got == [message for message in expected if message in got]
            assert sum(loss.count for loss in container.losses) == 120 - len(got)
            assert recordings.causes(container) == ([] if room else ["too-large"])


class Chunk(NamedTuple):
    """Offsets of its record and of a byte within its data; the log times it spans."""

    begin: int
    inside: int
    start_ns: int
    end_ns: int


def chunks_of(path: Any, form: str) -> list[Chunk]:
    """As the libraries see them."""
    if form.startswith("bag"):
        with Reader(path) as bag:
            return [Chunk(each.pos, each.pos + 200, each.start_time, each.end_time) for each in bag.chunk_infos]
    with path.open("rb") as file:
        return [
            Chunk(
                each.chunk_start_offset,
                each.chunk_start_offset + each.chunk_length - 10,
                each.message_start_time,
                each.message_end_time,
            )
            for each in make_reader(file).get_summary().chunk_indexes
        ]


@pytest.mark.parametrize("form", [*MCAPS, "bag-bz2"])
def test_a_flipped_byte_costs_its_chunk_only_and_is_counted_once(tmp_path, form):
    messages = recordings.some()
    path = recordings.build(form, tmp_path / "walk", messages)
    chunk = chunks_of(path, form)[2]
    recordings.flip(path, chunk.inside)
    left = [m for m in messages if not chunk.start_ns <= m[1] <= chunk.end_ns]
    with open_container(path) as container:
        for _ in range(2):
            assert recordings.read(container) == left
        (loss,) = container.losses
        assert loss.cause in (("crc",) if form == "mcap-none" else ("crc", "damaged"))
        assert loss.count == len(messages) - len(left) > 0
        assert f"offset {chunk.begin}" in loss.detail


@pytest.mark.parametrize("tail", ["cut", "zeros"])
@pytest.mark.parametrize("form", ["mcap", "bag-lz4"])
def test_a_truncated_file_gives_all_whole_chunks_and_says_until_when(tmp_path, form, tail):
    """After a power cut a file may end in zeros."""
    messages = recordings.some()
    path = recordings.build(form, tmp_path / "walk", messages)
    chunk = chunks_of(path, form)[3]
    data = path.read_bytes()
    path.write_bytes(data[: chunk.begin + 100] if tail == "cut" else data[: chunk.begin] + bytes(100))
    with open_container(path) as container:
        got = recordings.read(container)
        assert got == [m for m in messages if m[1] < chunk.start_ns]
        assert recordings.causes(container) == ["truncated" if form == "mcap" else "index", "truncated"]
        detail = container.losses[1].detail
        assert f"100 bytes after offset {chunk.begin}" in detail
        # 1.7e9 s is 2023-11-14T22:13:20Z.
        assert f"2023-11-14T22:13:{20 + (got[-1][1] - recordings.BASE_NS) / 1e9:06.3f}Z" in detail
        assert container.span_ns == (got[0][1], got[-1][1])
        assert sum(channel.count for channel in container.channels) == len(got)


EDITS = st.binary(min_size=6, max_size=24)


@cache
def sound(form):
    with TemporaryDirectory() as folder:
        return recordings.build(form, Path(folder) / "walk", recordings.some(40)).read_bytes()


@pytest.mark.parametrize("form", [form for form in FORMS if form != "split"])
@given(edits=EDITS)
def test_after_any_damage_nothing_is_invented_and_what_is_missing_is_a_loss(form, edits):
    """Bytes overwritten, cut out, or the end cut off; reading it again changes nothing."""
    messages = recordings.some(40)
    with TemporaryDirectory() as folder, suppress(QuadlogError):
        path = Path(folder) / "walk"
        path.write_bytes(edited(sound(form), edits))
        with open_container(path) as container:
            for _ in range(2):
                found = len(recordings.read(container))
                assert found <= len(messages)
                assert found == len(messages) or container.losses
                losses = list(container.losses)
            assert recordings.read(container) == recordings.read(container)
            assert container.losses == losses


def overwrite(old: bytes, new: bytes) -> Any:
    return lambda data, _: data.replace(old, new)


def damage_all(data: bytes, chunks: list[Chunk]) -> bytes:
    for chunk in chunks:
        data = data[: chunk.inside] + bytes([data[chunk.inside] ^ 0xFF]) + data[chunk.inside + 1 :]
    return data


@pytest.mark.parametrize(
    ("form", "damage", "words"),
    [
        ("mcap-zstd", overwrite(b"\4\0\0\0zstd", b"\4\0\0\0brot"), "'brot'"),
        ("bag-bz2", overwrite(b"compression=bz2", b"compression=xyz"), "'xyz'"),
        ("mcap", lambda data, _: data[:30], "offset"),
        ("bag", lambda data, chunks: data[: chunks[0].begin + 50], "offset"),
        ("mcap-none", damage_all, "checksum"),
        ("bag-bz2", damage_all, "bz2 data cannot be decompressed"),
    ],
)
def test_a_recording_without_a_message_left_is_nothing_readable(tmp_path, form, damage, words):
    options = {"enable_crcs": False} if form == "mcap-zstd" else {}
    path = recordings.build(form, tmp_path / "walk", recordings.some(), **options)
    path.write_bytes(damage(path.read_bytes(), chunks_of(path, form)))
    with pytest.raises(NothingReadable, match=words), open_container(path) as container:
        list(container.messages())


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty"),
        (b"hello", "unknown file format"),
        (gzip.compress(b"x", mtime=0), "gunzip"),
        (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        (b"#ROSBAG V1.2\n", "rosbag fix"),
        (b"SQLite format 3\0", "SQLite"),
        (b"\x28\xb5\x2f\xfdnonsense", "decompress"),
    ],
)
def test_other_formats_are_refused_in_one_line(tmp_path, content, words):
    path = tmp_path / "a.bag"
    path.write_bytes(content)
    with pytest.raises(NotARecording, match=words) as caught:
        open_container(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_files_and_pipes_are_refused(tmp_path):
    with pytest.raises(RecordingNotFound):
        open_container(tmp_path / "none.mcap")
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(NotARecording, match="regular"):
        open_container(tmp_path / "pipe.mcap")
