"""One object behind a URL, by fsspec: its metadata, any range of its bytes, and all of them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

from quadlog.errors import FileError, StorageChanged, StorageFailed
from quadlog.storage.byte_source import ByteSource, Kept, Span
from quadlog.storage.urls import explained, is_web, protocol_of, redacted

# A server that never answers is given up after a minute and a half.
CONNECT_S, READ_S = 10, 15
TRIES, WAIT_S = 3, 0.5
_PATIENCE_S, _SLOWEST_BYTES_PER_S = 60.0, 20_000
_AT_A_TIME = 16
# Small beside a chunk of a recording (about 1 MB).
BLOCK_BYTES, _STREAMED_BYTES = 1 << 16, 8 << 20
_CONTENT_RANGE = re.compile(r"bytes (\d{1,18})-(\d{1,18})/(\d{1,18})")
_KNOWN = "there are s3, http, https, gs, abfs, sftp and others of fsspec"


@dataclass(frozen=True, slots=True)
class ObjectInfo:
    """Metadata of an object or a folder: size_bytes None where unknown; ranges: whether byte ranges are served."""

    size_bytes: int | None
    ranges: bool = True
    etag: str | None = None
    last_modified: str | None = None
    is_folder: bool = False

    @property
    def st_size(self) -> int:
        """As `os.stat` has it; 0 where unknown."""
        return self.size_bytes or 0


def object_info(info: Mapping[str, Any]) -> ObjectInfo:
    """The metadata in fsspec's info of a file; each system has its own names for the version."""
    size = info.get("size")
    etag = next((str(info[name]) for name in ("ETag", "etag", "md5Hash", "content_md5") if info.get(name)), None)
    times = ("LastModified", "Last-Modified", "last_modified", "updated", "mtime", "modified", "created")
    modified = next((str(info[name]) for name in times if info.get(name)), None)
    size_bytes = size if isinstance(size, int) and size >= 0 else None
    return ObjectInfo(size_bytes, info.get("partial", True), etag, modified, info.get("type") != "file")


def info_of(url: str) -> ObjectInfo:
    """The metadata as it is now. Raises FileNotFoundError, FileError, StorageFailed."""
    system = filesystem(url)
    with explained(url):
        place = system._strip_protocol(url)
        system.invalidate_cache(place)
        return object_info(system.info(place))


class RemoteBytes(ByteSource):
    """An object that is read by range (ByteSource); what was read is kept, so that it is fetched once."""

    def __init__(self, url: str, info: ObjectInfo) -> None:
        self.size = info.st_size
        self._url, self._info, self._kept = url, info, Kept()

    def read(self, offset: int, length: int) -> bytes:
        """Bytes from offset on, fewer at the end of the object. Raises StorageFailed, StorageChanged."""
        end = min(offset + length, self.size)
        if offset >= end:
            return b""
        if end - offset >= BLOCK_BYTES:
            return self._stretch(offset, end)
        first = offset // BLOCK_BYTES * BLOCK_BYTES
        blocks = [self._stretch(at, min(at + BLOCK_BYTES, self.size)) for at in range(first, end, BLOCK_BYTES)]
        return b"".join(blocks)[offset - first : end - first]

    def read_each(self, spans: Sequence[Span]) -> list[bytes]:
        """No more than these is fetched, several at a time, and nothing is kept."""
        return self._fetch([(offset, min(offset + length, self.size)) for offset, length in spans])

    def check_unchanged(self) -> None:
        with suppress(FileNotFoundError):
            if info_of(self._url) == self._info:
                return
        raise StorageChanged(redacted(self._url))

    def stream(self) -> Iterator[bytes]:
        """All bytes from the first on, in blocks, of which nothing is kept. Raises StorageFailed, StorageChanged."""
        if self._info.ranges and self._info.size_bytes is not None:
            for start in range(0, self.size, _STREAMED_BYTES):
                yield self._fetch([(start, min(start + _STREAMED_BYTES, self.size))])[0]
        else:
            system, received = filesystem(self._url), 0
            with self._compared(), system.open(system._strip_protocol(self._url), "rb", block_size=0) as file:
                while block := file.read(1 << 20):
                    received += len(block)
                    yield block
            if self._info.size_bytes not in (None, received):
                raise StorageFailed(redacted(self._url), f"{received} bytes received, {self.size} announced")
        self.check_unchanged()

    def _stretch(self, start: int, end: int) -> bytes:
        return bytes(self._kept.data((start, end), lambda: self._fetch([(start, end)])[0]))

    def _fetch(self, ranges: Sequence[tuple[int, int]]) -> list[bytes]:
        """The bytes from start to end, end excluded, of each range. Raises StorageFailed, StorageChanged."""
        system = filesystem(self._url)
        wanted = [(start, end) for start, end in ranges if start < end]
        starts, ends = ([*each] for each in zip(*wanted, strict=True)) if wanted else ([], [])
        with self._compared():
            paths = [system._strip_protocol(self._url)] * len(wanted)
            at_once = {"batch_size": _AT_A_TIME} if system.async_impl else {}
            parts = system.cat_ranges(paths, starts, ends, on_error="raise", **at_once)
            if [len(part) for part in parts] != [end - start for start, end in wanted]:
                raise StorageFailed(redacted(self._url), "the server sent more or fewer bytes than were requested")
        found = iter(parts)
        return [bytes(next(found)) if start < end else b"" for start, end in ranges]

    @contextmanager
    def _compared(self) -> Iterator[None]:
        """Where a server fails within, the object may have been replaced, or be gone."""
        try:
            with explained(self._url):
                yield
        except FileNotFoundError:
            raise StorageChanged(redacted(self._url)) from None
        except StorageFailed:
            self.check_unchanged()
            raise


def filesystem(url: str) -> Any:
    """The file system of fsspec for a URL, with bounded patience. Raises FileError, StorageFailed."""
    import fsspec

    protocol = protocol_of(url)
    own = fsspec.config.conf.get(protocol, {})
    try:
        with explained(url):
            if is_web(url):
                return _http(url, own)
            kind = fsspec.get_filesystem_class(protocol)
            # The server and the user that a URL names, for systems like ftp that have one connection for each.
            found = kind._get_kwargs_from_urls(url)
            login = {name: found[name] for name in ("host", "port", "username", "password") if found.get(name)}
            if protocol not in ("s3", "s3a"):
                return kind(**login)
            waits: dict[str, Any] = {"connect_timeout": CONNECT_S, "read_timeout": READ_S}
            waits["retries"] = {"total_max_attempts": TRIES, "mode": "standard"}
            # Listings are not cached: another machine may be writing there.
            system = kind(config_kwargs=waits | own.get("config_kwargs", {}), use_listings_cache=False, **login)
            system.retries = 2
            return system
    except StorageFailed as failure:
        if isinstance(failure.__cause__, ImportError):
            remedy = "pip install 'quadlog[s3]'" if protocol in ("s3", "s3a") else failure.reason
            raise FileError(redacted(url), f"{protocol}:// needs another package: {remedy}") from None
        if isinstance(failure.__cause__, (ValueError, TypeError)):  # TypeError: it needs more than its options
            raise FileError(redacted(url), f"{protocol}:// is not a protocol that quadlog reads; {_KNOWN}") from None
        raise


def _http(url: str, own: Mapping[str, Any]) -> Any:
    import aiohttp

    # trust_env: proxies and .netrc, as every other tool takes them.
    timeout = aiohttp.ClientTimeout(total=None, sock_connect=CONNECT_S, sock_read=READ_S)
    client = {"timeout": timeout, "trust_env": True, **own.get("client_kwargs", {})}
    # Never compressed: lengths and offsets are those of the file itself.
    headers = {**own.get("headers", {}), "Accept-Encoding": "identity"}
    # Whether a URL is quoted already decides what is sent: a signature must arrive as it was made.
    return _checked_http()(client_kwargs=client, headers=headers, encoded=url.isascii() and " " not in url)


class _Part(NamedTuple):
    """What a server sends of a file of this size: the requested bytes, or None where it would send the whole file."""

    size: int | None
    data: bytes | None
    headers: Mapping[str, str]


@lru_cache(1)
def _checked_http() -> Any:
    import asyncio

    import aiohttp
    from fsspec.implementations.http import HTTPFileSystem

    class CheckedHttp(HTTPFileSystem):  # type: ignore[misc]
        """Fsspec's own takes any body for a range, and tries once."""

        async def _info(self, url: str, **_: Any) -> dict[str, Any]:
            # One byte is requested for size, version and support of ranges: a signature may allow GET alone.
            part = await self._tried(url, 0, 1)
            info = {name: part.headers.get(name) for name in ("ETag", "Last-Modified")}
            return {"name": url, "type": "file", "size": part.size, "partial": part.data is not None} | info

        async def _cat_file(self, url: str, start: int | None = None, end: int | None = None, **_: Any) -> bytes:
            part = await self._tried(url, start or 0, end or 0)
            if part.data is None:
                raise StorageFailed(redacted(url), "the server sent the whole file for a range of it")
            return part.data

        async def _tried(self, url: str, start: int, end: int) -> _Part:
            for left in reversed(range(TRIES)):
                try:
                    async with asyncio.timeout(_PATIENCE_S + (end - start) / _SLOWEST_BYTES_PER_S):
                        return await self._part(url, start, end)
                except (aiohttp.ClientError, EOFError, OSError) as error:
                    status = getattr(error, "status", 500)
                    if not left or isinstance(error, FileNotFoundError) or (status < 500 and status != 429):
                        raise
                    await asyncio.sleep(WAIT_S)
            raise AssertionError

        async def _part(self, url: str, start: int, end: int) -> _Part:
            session = await self.set_session()
            headers = {**self.kwargs["headers"], "Range": f"bytes={start}-{end - 1}"}
            async with session.get(self.encode_url(url), **{**self.kwargs, "headers": headers}) as answer:
                if answer.status in (404, 410):
                    raise FileNotFoundError(url)
                whole = answer.headers.get("Content-Encoding", "identity") == "identity"
                if answer.status == 200:
                    answer.close()  # it was not requested, and is not read
                    return _Part(answer.content_length if whole else None, None, answer.headers)
                if answer.status == 416 and end == 1:
                    return _Part(0, b"", answer.headers)
                answer.raise_for_status()
                found = _CONTENT_RANGE.fullmatch(answer.headers.get("Content-Range", ""))
                if found is None or not whole or answer.status != 206:
                    raise StorageFailed(redacted(url), "the server sent a part without its range")
                if (int(found[1]), int(found[2])) != (start, end - 1):
                    raise StorageFailed(redacted(url), "the server returned another range than requested")
                return _Part(int(found[3]), await answer.content.readexactly(end - start), answer.headers)

    return CheckedHttp
