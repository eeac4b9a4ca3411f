"""Decompression of untrusted data, of single messages, chunks and whole files: every frame of it, and never more
bytes than allowed.
"""

from __future__ import annotations

import bz2
import io
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import zstandard

from quadlog.errors import NotARecording
from quadlog.recordings.containers.container import MAX_CHUNK_BYTES, Damaged, Loss, RawMessage
from quadlog.recordings.formatting import several
from quadlog.storage.byte_source import fill

SUPPORTED = ("", "none", "zstd", "lz4", "bz2")

SPARE_BYTES = 1 << 32
"""What all chunks of a file may hold beyond what their size is worth."""
# What data may grow to when decompressed: recorders' chunks of 1 to 16 MB always, more where the data is worth it.
_ALWAYS_BYTES = 1 << 25
_MAX_RATIO = 256
# What a byte beyond that ratio costs of a file's allowance, as the time that it takes.
_COST = {"bz2": 32}
_MAX_STREAMS = 1000
# Two kilobytes of zstd hold at most 512 blocks of 128 KB, which bounds what one call allocates.
_ZSTD_SLICE_BYTES = 1 << 11
# Of a frame, and of the frames that decoders skip (pzstd starts with one).
_ZSTD_MAGICS = (b"\x28\xb5\x2f\xfd", *(bytes([0x50 + number]) + b"\x2a\x4d\x18" for number in range(16)))


class Incomplete(Exception):
    """Compressed data ends in the middle of a frame."""


class Allowance:
    """So much for all places of a file together; a place that is read again counts once."""

    def __init__(self, most: int) -> None:
        self._left, self._taken = most, dict[int, int]()

    def take(self, place: int, amount: int) -> bool:
        """Whether there is so much for the place."""
        taken = self._taken.get(place, 0)
        more = max(amount - taken, 0)
        if more > self._left:
            return False
        self._left, self._taken[place] = self._left - more, taken + more
        return True


def decompress(compression: str, data: memoryview, size: int, spare: Allowance, offset: int) -> memoryview:
    """The size bytes that data holds, a chunk of a file at this offset. spare: bytes beyond what their size is worth.

    Raises Damaged when it holds something else, the scheme is unknown, or there is no allowance left for it.
    """
    if compression not in SUPPORTED:
        raise Damaged(f"compressed with {compression!r}, which quadlog does not read", "compression")
    if size > (limit := largest_size(len(data))):
        raise Damaged(f"{size} bytes uncompressed exceed the limit of {limit} for {len(data)} compressed", "too-large")
    beyond = size - _MAX_RATIO * len(data)
    if beyond > 0 and not spare.take(offset, beyond * _COST.get(compression, 1)):
        raise Damaged(f"the chunks before it hold too much for their size; {size} bytes more are too many", "too-large")
    if compression in ("", "none"):
        body: bytes | bytearray | memoryview = data
    else:
        try:
            body = _INFLATE[compression](data, size)
        except (zstandard.ZstdError, Incomplete, RuntimeError, OSError, ValueError, EOFError) as error:
            raise Damaged(f"{compression} data cannot be decompressed ({error})") from None
    if len(body) != size:
        raise Damaged(f"holds {len(body)} bytes where {size} are declared")
    return memoryview(body)


def largest_size(compressed_bytes: int) -> int:
    """How many bytes compressed data may hold: memory is spent in proportion to what was read."""
    return min(MAX_CHUNK_BYTES, max(_ALWAYS_BYTES, _MAX_RATIO * compressed_bytes))


def is_zstd(head: bytes) -> bool:
    """Whether these are the first bytes of zstd data."""
    return head.startswith(_ZSTD_MAGICS)


def inflate_zstd(data: bytes | memoryview, limit: int) -> bytes | bytearray:
    """All frames of zstd data, one after the other (pzstd, concatenated files).

    Raises zstandard.ZstdError for what is no zstd, Incomplete for a frame without its end, ValueError beyond limit.
    """
    # The library allocates what the frame declares, whatever limit it is given.
    declared = zstandard.get_frame_parameters(data).content_size
    if limit < declared != zstandard.CONTENTSIZE_UNKNOWN:
        raise ValueError(f"it holds more than {limit} bytes")
    with suppress(zstandard.ZstdError):  # another frame follows, or it is damaged
        return _per_thread.zstd.decompress(data, max_output_size=max(limit, 1), allow_extra_data=False)
    body = bytearray()
    for block in zstd_blocks(io.BytesIO(data), min(_ZSTD_SLICE_BYTES, max(limit >> 12, 1))):
        body += block
        if len(body) > limit:
            raise ValueError(f"it holds more than {limit} bytes")
    return body


def zstd_blocks(packed: BinaryIO, slice_bytes: int = _ZSTD_SLICE_BYTES) -> Iterator[bytes]:
    """What all frames of a zstd file hold, in blocks of at most 64 MB. Raises zstandard.ZstdError and Incomplete."""
    frame = None
    while rest := packed.read(slice_bytes):
        while rest:
            frame = frame or zstandard.ZstdDecompressor().decompressobj()
            yield frame.decompress(rest)
            rest = frame.unused_data
            if frame.eof:
                frame = None
    if frame is not None:
        raise Incomplete("it ends too early")


class _PerThread(threading.local):
    """Making a decompressor costs as much as a small chunk, and two threads must not share one."""

    def __init__(self) -> None:
        self.zstd = zstandard.ZstdDecompressor()


_per_thread = _PerThread()


def _inflate_streams(new: Callable[[], Any], data: memoryview, size: int) -> bytes | bytearray:
    """All streams in data, one after the other; the libraries' own functions would grow without a bound."""
    body: bytes | bytearray = b""
    rest: bytes | memoryview | None = data
    for _ in range(_MAX_STREAMS):
        if not rest:
            return body
        stream = new()
        part = stream.decompress(rest, max_length=max(size - len(body), 1))
        if not stream.eof:
            # The end mark may follow the last byte asked for.
            part += stream.decompress(b"", max_length=1)
        if not stream.eof:
            raise ValueError("it ends too early or holds more than declared")
        body = bytearray(body) + part if body else part
        rest = stream.unused_data
    raise ValueError(f"it has more than {_MAX_STREAMS} streams")


_INFLATE: dict[str, Callable[[memoryview, int], bytes | bytearray]] = {
    "zstd": inflate_zstd,
    "lz4": partial(_inflate_streams, lz4.frame.LZ4FrameDecompressor),
    "bz2": partial(_inflate_streams, bz2.BZ2Decompressor),
}


def unpack(path: Path, target: Path) -> list[str]:
    """Decompress into a new file: no warning, or one where the compressed data is damaged.

    What lies before the damage is there: readers recover recordings without their end, and report it as a loss.
    Raises NotARecording when there is nothing, and what `fill` raises.
    """
    damage, warnings = list[Exception](), list[str]()

    def blocks() -> Iterator[bytes]:
        try:
            with path.open("rb") as packed:
                yield from zstd_blocks(packed)
        except (zstandard.ZstdError, Incomplete) as error:
            damage.append(error)

    written = fill(target, blocks(), path)
    if damage and not written:
        raise NotARecording(path, f"it cannot be decompressed ({damage[0]})")
    if damage:
        read = several(written, "byte")
        warnings.append(f"its compressed data is damaged ({damage[0]}); the {read} before that were read")
    return warnings


def unpacked_name(path: Path) -> str:
    """The name without `.zstd` or `.zst`."""
    return path.stem if path.suffix.lower() in (".zstd", ".zst") else path.name


def unpack_messages(messages: Iterable[RawMessage], losses: list[Loss]) -> Iterator[RawMessage]:
    """Messages whose payload is zstd data, decompressed; one that is not is counted as a loss."""
    unreadable, spare = Counter[str](), SPARE_BYTES >> 2
    for message in messages:
        worth = _MAX_RATIO * len(message.payload)
        limit = min(largest_size(len(message.payload)), worth + spare)
        try:
            payload = memoryview(inflate_zstd(message.payload, limit))
            spare -= max(len(payload) - worth, 0)
        except (zstandard.ZstdError, Incomplete, ValueError) as error:
            spare -= limit - worth if isinstance(error, ValueError) else 0  # it grew to the limit in vain
            unreadable[message.channel.topic] += 1
            continue
        yield RawMessage(message.channel, message.log_time_ns, payload)
    for topic, count in sorted(unreadable.items()):
        losses.append(Loss("compression", f"{several(count, 'message')} cannot be decompressed", topic, count))
