from __future__ import annotations

import random
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from time import sleep

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.storage import byte_ranges as remote_bytes
from quadlog.storage.byte_ranges import BLOCK_BYTES, RemoteBytes
from quadlog.storage.remote_object import ObjectInfo

SIZE = 7 * BLOCK_BYTES + 1234
CONTENT = random.Random(0).randbytes(SIZE)
READS = st.lists(st.tuples(st.integers(0, SIZE + 10), st.integers(0, 3 * BLOCK_BYTES)), min_size=1, max_size=8)


def blocks(start: int, end: int) -> range:
    """Those of the file that have any byte from start to end."""
    end = min(end, SIZE)
    return range(start // BLOCK_BYTES, -(-end // BLOCK_BYTES)) if start < end else range(0)


class Served:
    """An object in memory that counts how often each of its bytes is asked for."""

    url = "s3://lab/walk?sig=1"
    info = ObjectInfo(SIZE)

    def __init__(self) -> None:
        self.asked: list[tuple[int, int]] = []

    def fetch(self, start: int, end: int) -> bytes:
        self.asked.append((start, end))
        return CONTENT[start:end]

    def times(self) -> Counter[int]:
        return Counter(block for start, end in self.asked for block in blocks(start, end))


@given(READS)
def test_reads_are_those_of_the_file_and_no_block_comes_twice(reads: list[tuple[int, int]]) -> None:
    served = Served()
    source = RemoteBytes(served, SIZE)
    try:
        for offset, length in reads:
            assert source.read(offset, length) == CONTENT[offset : offset + length]
    finally:
        source.close()
    assert set(served.times().values()) <= {1}
    assert set(served.times()) == {block for offset, length in reads for block in blocks(offset, offset + length)}


def test_blocks_that_this_machine_loses_come_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that fails here is no damage of a recording there."""
    served = Served()
    source = RemoteBytes(served, SIZE)
    source.read(0, 10)

    def failing(*_: int) -> bytes:
        raise OSError(5, "Input/output error")

    for pread in (failing, lambda *_: b""):
        monkeypatch.setattr(remote_bytes.os, "pread", pread)
        assert source.read(0, 10) == CONTENT[:10]
    source.close()
    assert served.times() == {0: 3}


def test_threads_share_fetched_blocks() -> None:
    """What one of them fetches the others wait for."""
    served = Served()
    fetch = served.fetch

    def slow(start: int, end: int) -> bytes:
        sleep(0.002)
        return fetch(start, end)

    served.fetch = slow  # type: ignore[method-assign]
    source = RemoteBytes(served, SIZE)
    draw = random.Random(1)
    reads = [(draw.randrange(SIZE), draw.randrange(2 * BLOCK_BYTES)) for _ in range(400)]
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda each: source.read(*each), reads))
    source.close()
    assert found == [CONTENT[offset : offset + length] for offset, length in reads]
    assert set(served.times().values()) == {1}
