"""Small files that promise much more than they are worth: refused or read within bounded memory."""

from __future__ import annotations

import bz2
import json
import random
import struct
import subprocess
import sys
from collections.abc import Iterable
from contextlib import nullcontext
from pathlib import Path

import lz4.frame
import pytest
import zstandard

from quadlog.errors import NothingReadable, TooLarge
from quadlog.recordings.containers.compression import SPARE_BYTES, unpack_messages
from quadlog.recordings.containers.container import Channel, Loss, RawMessage
from quadlog.recordings.containers.open import MOST_CHANNELS, open_container
from tests.lab import recordings

MEBIBYTE = 1 << 20

READ_ALL = """
import json, sys
from quadlog.errors import QuadlogError
from quadlog.pipelines.executor.progress import peak_memory_mb
from quadlog.recordings.containers.open import open_container
found = []
for path in sys.argv[1:]:
    messages, causes = 0, []
    try:
        with open_container(__import__("pathlib").Path(path)) as container:
            try:
                for message in container.messages():
                    messages += 1
            finally:
                causes = sorted({loss.cause for loss in container.losses})
    except QuadlogError as error:
        causes = causes or [type(error).__name__]
    found.append([messages, causes, peak_memory_mb() < 500])
print(json.dumps(found))
"""


def zstd(parts: Iterable[tuple[bytes, int]]) -> tuple[bytes, int]:
    """Compressed and uncompressed size, without the whole in memory."""
    parts = list(parts)
    size = sum(len(each) * count for each, count in parts)
    packer = zstandard.ZstdCompressor(level=1).compressobj(size=size)
    packed = [packer.compress(each) for part, count in parts for each in (part,) * count]
    return b"".join([*packed, packer.flush()]), size


def large(begin: bytes, mebibytes: int, *after: bytes) -> list[tuple[bytes, int]]:
    """What begins so, goes on with zeros, and what comes after it."""
    return [(begin, 1), (bytes(MEBIBYTE), mebibytes), *((each, 1) for each in after)]


def large_message(mebibytes: int) -> list[tuple[bytes, int]]:
    return large(recordings.message(0, more=mebibytes * MEBIBYTE), mebibytes, recordings.message(10**9))


def definition(number: int, mebibytes: int) -> list[tuple[bytes, int]]:
    size = mebibytes * MEBIBYTE
    head = struct.pack("<H", number) + recordings.text(b"a") + recordings.text(b"ros2msg") + struct.pack("<I", size)
    return large(recordings.record(3, head, size), mebibytes)


BOMBS = {
    "chunks of 512 MB": (large_message(511), 20, 0),
    "chunks of 31 MB": (large_message(31), 5, 10),
    # Several such chunks are merged message by message: none is next to the one before it.
    "overlapping chunks of 31 MB": (
        large(recordings.record(0x80, b"", 31 * MEBIBYTE), 31, *map(recordings.message, range(500))),
        16,
        8000,
    ),
    "17 M empty messages": ([(recordings.message() * 34_000, 500)], 1, 0),
    "20 M empty records": ([(recordings.record(0x80, b"") * 40_000, 500)], 1, 0),
    "definitions of 15 MB": ([part for number in range(1, 7) for part in definition(number, 15)], 1, 0),
}
"""What the chunks are made of, how often they come, and the messages that are read nevertheless."""


def test_memory_of_a_chunk_is_bounded_by_the_size_of_the_file(tmp_path: Path) -> None:
    paths = []
    for name, (parts, count, _) in BOMBS.items():
        packed, size = zstd(parts)
        chunks = [recordings.chunk(size, b"zstd", packed)] * count
        paths.append(recordings.write_records(tmp_path / f"{name}.mcap", recordings.channel(), *chunks))
        assert paths[-1].stat().st_size < 400_000
    done = subprocess.run([sys.executable, "-c", READ_ALL, *map(str, paths)], capture_output=True, check=True)
    expected = [[messages, ["truncated"] if messages else ["NothingReadable"], True] for *_, messages in BOMBS.values()]
    assert json.loads(done.stdout) == expected


def test_more_topics_than_any_robot_has_are_refused(tmp_path: Path) -> None:
    channels = map(recordings.channel, range(MOST_CHANNELS + 1))
    path = recordings.write_records(tmp_path / "a.mcap", *channels, recordings.message())
    with pytest.raises(TooLarge, match=r"a\.mcap: topics: 4097 exceeds the limit of 4096"):
        open_container(path)


def test_what_chunks_hold_beyond_their_size_counts_once_for_a_file_and_however_often_they_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """bzip2 takes a sixth of a second for the 31 MB of each of these chunks, which have 110 bytes."""
    monkeypatch.setattr("quadlog.recordings.containers.compression.SPARE_BYTES", SPARE_BYTES // 4)
    data = recordings.bag_message(bytes(31 * MEBIBYTE))
    path = recordings.bag_of(tmp_path / "a.bag", b"bz2", bz2.compress(data), len(data), 40)
    assert path.stat().st_size < 13_500
    with open_container(path) as container:
        for _ in range(2):
            assert sum(1 for _ in container.messages()) == 1
        assert {loss.cause for loss in container.losses} == {"index", "too-large"}
        assert "39 chunks" in container.losses[1].detail


@pytest.mark.parametrize("form", ["bag", "mcap"])
@pytest.mark.parametrize(("noise_bytes", "read"), [(18_000, True), (2_000, False)])
def test_more_messages_than_bytes_of_the_file_are_refused(tmp_path, form, noise_bytes, read):
    """Chunks of 10 000 empty messages that took less than a byte each."""
    noise = random.Random(0).randbytes(noise_bytes)
    if form == "bag":
        data = recordings.bag_message(noise) + recordings.bag_message() * 10_000
        path = recordings.bag_of(tmp_path / "a.bag", b"lz4", lz4.frame.compress(data), len(data), 4)
    else:
        data = recordings.message(0, noise) + recordings.message() * 10_000
        chunks = [recordings.chunk(len(data), b"zstd", zstandard.compress(data))] * 4
        path = recordings.write_records(tmp_path / "a.mcap", recordings.channel(), *chunks)
    refused = pytest.raises(NothingReadable, match=r"more than \d+ records")
    with nullcontext() if read else refused, open_container(path) as container:
        assert [sum(1 for _ in container.messages()) for _ in range(2)] == [4 * 10_001] * 2


def test_single_messages_have_an_allowance_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of frames that say how much they hold, and of others."""
    monkeypatch.setattr("quadlog.recordings.containers.compression.SPARE_BYTES", SPARE_BYTES // 16)
    for sized in (True, False):
        packer = zstandard.ZstdCompressor(level=1).compressobj(size=31 * MEBIBYTE if sized else -1)
        packed = packer.compress(bytes(31 * MEBIBYTE)) + packer.flush()
        losses: list[Loss] = []
        channel = Channel("/a", "t", "cdr", "ros2msg", b"")
        messages = (RawMessage(channel, t_ns, memoryview(packed)) for t_ns in range(20))
        assert sum(1 for _ in unpack_messages(messages, losses)) == 2
        assert [(loss.cause, loss.count) for loss in losses] == [("compression", 18)]
