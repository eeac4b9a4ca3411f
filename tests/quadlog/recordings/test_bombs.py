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


def record(opcode: int, content: bytes, more: int = 0) -> bytes:
    """A record, or the beginning of one whose content goes on for so many bytes."""
    return struct.pack("<BQ", opcode, len(content) + more) + content


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def message(t_ns: int = 0, more: int = 0) -> bytes:
    return record(5, struct.pack("<HIQQ", 1, 0, t_ns, t_ns), more)


def zstd(parts: Parts) -> tuple[bytes, int]:
    """Compressed and uncompressed size, without the whole in memory."""
    parts = list(parts)
    size = sum(len(each) * count for each, count in parts)
    packer = zstandard.ZstdCompressor(level=1).compressobj(size=size)
    packed = [packer.compress(each) for part, count in parts for each in (part,) * count]
    return b"".join([*packed, packer.flush()]), size


def chunk(*parts: tuple[bytes, int]) -> bytes:
    packed, size = zstd(parts)
    return record(6, struct.pack("<QQQI", 0, 10**9, size, 0) + text(b"zstd") + struct.pack("<Q", len(packed)) + packed)


def zeros(mebibytes: int) -> tuple[bytes, int]:
    return bytes(MEBIBYTE), mebibytes


def large_message(mebibytes: int) -> list[tuple[bytes, int]]:
    return [(message(0, mebibytes * MEBIBYTE), 1), zeros(mebibytes), (message(10**9), 1)]


def interleaved(mebibytes: int) -> list[tuple[bytes, int]]:
    """Many messages, of which none is next to the one before it when several such chunks are merged."""
    filler = (record(0x80, b"", mebibytes * MEBIBYTE), 1)
    return [filler, zeros(mebibytes), *((message(t_ns), 1) for t_ns in range(4000))]


def schema(number: int, mebibytes: int) -> list[tuple[bytes, int]]:
    head = struct.pack("<H", number) + text(b"a") + text(b"ros2msg") + struct.pack("<I", mebibytes * MEBIBYTE)
    return [(record(3, head, mebibytes * MEBIBYTE), 1), zeros(mebibytes)]


# What the chunks are made of, how often they come, and the messages that are read nevertheless.
BOMBS = {
    "chunks of 512 MB": (large_message(511), 20, 0),
    "chunks of 190 MB": (large_message(190), 20, 0),
    "chunks of 31 MB": (large_message(31), 5, 10),
    "overlapping chunks of 31 MB": (interleaved(31), 20, None),
    "17 M empty messages": ([(message() * 34_000, 500)], 1, 0),
    "4 M empty messages": ([(message() * 8_000, 500)], 1, 0),
    "20 M empty records": ([(record(0x80, b"") * 40_000, 500)], 1, 0),
    "definitions of 15 MB": ([part for number in range(1, 7) for part in schema(number, 15)], 1, 0),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_chunk_costs_what_the_file_is_worth(tmp_path: Path, name: str) -> None:
    parts, count, messages = BOMBS[name]
    channel = record(4, struct.pack("<HH", 1, 0) + text(b"/a") + text(b"cdr") + struct.pack("<I", 0))
    path = tmp_path / "a.mcap"
    path.write_bytes(b"".join([b"\x89MCAP0\r\n", channel, *[chunk(*parts)] * count, record(15, bytes(4))]))
    assert path.stat().st_size < 400_000
    done = subprocess.run([sys.executable, "-c", READ_ALL, str(path)], capture_output=True, text=True, check=True)
    got = json.loads(done.stdout)
    assert got["peak_mb"] < 500
    if messages is None:
        assert got["causes"] == ["too-large", "truncated"]
    else:
        assert (got["messages"], got["causes"]) == (messages, ["truncated"] if messages else ["NothingReadable"])


def test_more_topics_than_any_robot_has_are_refused(tmp_path: Path) -> None:
    channels = b"".join(
        record(4, struct.pack("<HH", number, 0) + text(b"/t%d" % number) + text(b"cdr") + struct.pack("<I", 0))
        for number in range(MOST_CHANNELS + 1)
    )
    path = tmp_path / "a.mcap"
    path.write_bytes(b"".join([b"\x89MCAP0\r\n", channels, message(), record(15, bytes(4))]))
    with pytest.raises(TooLarge, match=r"a\.mcap: topics: 4097 exceeds the limit of 4096"):
        open_container(path)
