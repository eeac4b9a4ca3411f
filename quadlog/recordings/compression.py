"""Decompressing one chunk to exactly the size it declares, never to more."""

from __future__ import annotations

import bz2
import threading

import lz4.frame
import zstandard

from quadlog.recordings.bounded import MAX_CHUNK_BYTES, Damaged

SUPPORTED = ("", "none", "zstd", "lz4", "bz2")


def decompress(compression: str, data: memoryview, size: int) -> memoryview:
    """The size bytes that data holds. Raises Damaged when it holds something else or the scheme is unknown."""
    if compression not in SUPPORTED:
        raise Damaged(f"compressed with {compression!r}, which quadlog does not read", "compression")
    if size > MAX_CHUNK_BYTES:
        raise Damaged(f"{size} bytes uncompressed exceed the limit of {MAX_CHUNK_BYTES}", "too-large")
    if compression in ("", "none"):
        body: bytes | memoryview = data
    else:
        try:
            body = _INFLATE[compression](data, size)
        except (zstandard.ZstdError, RuntimeError, OSError, ValueError, EOFError) as error:
            raise Damaged(f"{compression} data cannot be decompressed ({error})") from None
    if len(body) != size:
        raise Damaged(f"holds {len(body)} bytes where {size} are declared")
    return memoryview(body)


class _PerThread(threading.local):
    """Making a decompressor costs as much as a small chunk, and two threads must not share one."""

    def __init__(self) -> None:
        self.zstd = zstandard.ZstdDecompressor()


_per_thread = _PerThread()


def _inflate_zstd(data: memoryview, size: int) -> bytes:
    # The library allocates what the frame declares, whatever limit it is given.
    declared = zstandard.get_frame_parameters(data).content_size
    if declared not in (size, zstandard.CONTENTSIZE_UNKNOWN):
        raise ValueError(f"its frame declares {declared} bytes instead of {size}")
    return _per_thread.zstd.decompress(data, max_output_size=max(size, 1))


def _inflate_lz4(data: memoryview, size: int) -> bytes:
    # lz4.frame.decompress would grow without a bound, and is slower.
    stream = lz4.frame.LZ4FrameDecompressor()
    body = stream.decompress(data, max_length=max(size, 1))
    if not stream.eof:
        raise ValueError("it ends too early or holds more than declared")
    return body


def _inflate_bz2(data: memoryview, size: int) -> bytes:
    stream = bz2.BZ2Decompressor()
    body = stream.decompress(data, max_length=max(size, 1))
    if not stream.eof:
        # The end-of-stream mark may follow the last byte asked for.
        body += stream.decompress(b"", max_length=1)
    if not stream.eof:
        raise ValueError("it ends too early or holds more than declared")
    return body


_INFLATE = {"zstd": _inflate_zstd, "lz4": _inflate_lz4, "bz2": _inflate_bz2}
