"""Small files that promise much more than they are worth: refused or read within bounded memory."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest
import zstandard

from quadlog.errors import TooLarge
from quadlog.recordings.containers.open import MOST_CHANNELS, open_container
from tests.lab import recordings

MEBIBYTE = 1 << 20
Parts = Iterable[tuple[bytes, int]]

READ_ALL = """
import json, sys
from quadlog.errors import QuadlogError
from quadlog.pipelines.executor.progress import peak_memory_mb
from quadlog.recordings.containers.open import open_container
messages, causes = 0, []
try:
    with open_container(__import__("pathlib").Path(sys.argv[1])) as container:
        try:
            for message in container.messages():
                messages += 1
        finally:
            causes = sorted({loss.cause for loss in container.losses})
except QuadlogError as error:
    causes = causes or [type(error).__name__]
print(json.dumps({"messages": messages, "causes": causes, "peak_mb": peak_memory_mb()}))
"""


def zstd(parts: Parts) -> tuple[bytes, int]:
    """Compressed and uncompressed size, without the whole in memory."""
    parts = list(parts)
    size = sum(len(each) * count for each, count in parts)
    packer = zstandard.ZstdCompressor(level=1).compressobj(size=size)
    packed = [packer.compress(each) for part, count in parts for each in (part,) * count]
    return b"".join([*packed, packer.flush()]), size


def zeros(mebibytes: int) -> tuple[bytes, int]:
    return bytes(MEBIBYTE), mebibytes


def bombs() -> dict[str, tuple[list[tuple[bytes, int]], int, int | None]]:
    """What the chunks are made of, how often they come, and the messages that are read nevertheless."""

    def large_message(mebibytes: int) -> list[tuple[bytes, int]]:
        return [(recordings.message(0, more=mebibytes * MEBIBYTE), 1), zeros(mebibytes), (recordings.message(10**9), 1)]

    def schema(number: int, mebibytes: int) -> list[tuple[bytes, int]]:
        size = mebibytes * MEBIBYTE
        head = struct.pack("<H", number) + recordings.text(b"a") + recordings.text(b"ros2msg") + struct.pack("<I", size)
        return [(recordings.record(3, head, size), 1), zeros(mebibytes)]

    # Several such chunks are merged message by message: none is next to the one before it.
    interleaved = [
        (recordings.record(0x80, b"", 31 * MEBIBYTE), 1),
        zeros(31),
        *((recordings.message(t), 1) for t in range(4000)),
    ]
    return {
        "chunks of 512 MB": (large_message(511), 20, 0),
        "chunks of 31 MB": (large_message(31), 5, 10),
        "overlapping chunks of 31 MB": (interleaved, 20, None),
        "17 M empty messages": ([(recordings.message() * 34_000, 500)], 1, 0),
        "20 M empty records": ([(recordings.record(0x80, b"") * 40_000, 500)], 1, 0),
        "definitions of 15 MB": ([part for number in range(1, 7) for part in schema(number, 15)], 1, 0),
    }


@pytest.mark.parametrize("number", range(6))
def test_memory_of_a_chunk_is_bounded_by_the_size_of_the_file(tmp_path: Path, number: int) -> None:
    parts, count, messages = list(bombs().values())[number]
    packed, size = zstd(parts)
    chunks = [recordings.chunk(size, b"zstd", packed)] * count
    path = recordings.write_records(tmp_path / "a.mcap", recordings.channel(), *chunks)
    assert path.stat().st_size < 400_000
    done = subprocess.run([sys.executable, "-c", READ_ALL, str(path)], capture_output=True, text=True, check=True)
    got = json.loads(done.stdout)
    assert got["peak_mb"] < 500
    if messages is None:
        assert got["causes"] == ["too-large", "truncated"]
    else:
        assert (got["messages"], got["causes"]) == (messages, ["truncated"] if messages else ["NothingReadable"])


def test_more_topics_than_any_robot_has_are_refused(tmp_path: Path) -> None:
    channels = map(recordings.channel, range(MOST_CHANNELS + 1))
    path = recordings.write_records(tmp_path / "a.mcap", *channels, recordings.message())
    with pytest.raises(TooLarge, match=r"a\.mcap: topics: 4097 exceeds the limit of 4096"):
        open_container(path)
