"""One object behind a URL, in a bucket or on a web server: its metadata, and any range of its bytes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from email.utils import parsedate_to_datetime
from typing import Any

from quadlog.errors import FileError, StorageChanged, StorageFailed
from quadlog.storage.urls import explained, protocol_of, redacted

_STREAMED_BYTES = 8 << 20
# A server that never answers is given up after a minute and a half.
CONNECT_S, READ_S = 10, 15
_TRIES, _TRIES_WITHIN = 2, 3


@dataclass(frozen=True, slots=True)
class ObjectInfo:
    """Metadata of an object: size_bytes None where unknown; ranges: whether the server serves byte ranges."""

    size_bytes: int | None
    ranges: bool = True
    etag: str | None = None
    last_modified: str | None = None

    def modified_ns(self) -> int:
        """The time of the last change, 0 where it is missing or in an unknown form."""
        for parse in (datetime.fromisoformat, parsedate_to_datetime):
            with suppress(ValueError, TypeError):
                return int(parse(self.last_modified or "").timestamp() * 1e9)
        return 0


def open_object(url: str) -> RemoteObject:
    """The object behind a URL. Raises FileNotFoundError, FileError, StorageFailed."""
    return WebObject(url) if protocol_of(url) in ("http", "https") else BucketObject(url)


class BucketObject:
    """An object of S3, or of any other system that fsspec knows. info: its server's answer when it was opened."""

    def __init__(self, url: str) -> None:
        self.url = url
        self._system = filesystem(url)
        # s3fs asks with If-Match through its files alone.
        self._conditional: Any = None
        with explained(url):
            self._path = self._system._strip_protocol(url)
            self._system.invalidate_cache(self._path)
            if hasattr(self._system, "call_s3"):
                self._conditional = self._system.open(self._path, "rb", cache_type="none")
                info = self._conditional.details
                if object_info(info).etag is None:
                    self._conditional = None
            else:
                info = self._system.info(self._path)
        if info.get("type") != "file":
            raise FileNotFoundError(redacted(url))
        self.info = object_info(info)

    def fetch(self, start: int, end: int) -> bytes:
        """The bytes from start to end, end excluded; several threads may ask at once.

        Raises StorageFailed, StorageChanged.
        """
        try:
            with explained(self.url):
                if self._conditional is not None:
                    data = self._conditional._fetch_range(start, end)
                else:
                    data = self._system.cat_file(self._path, start=start, end=end)
                    # These systems have no conditional requests: the version is compared after every part.
                    self._system.invalidate_cache(self._path)
                    if object_info(self._system.info(self._path)) != self.info:
                        raise StorageChanged(redacted(self.url))
        except FileNotFoundError:
            raise StorageChanged(redacted(self.url)) from None
        except StorageFailed as failure:
            if _is_unmet_condition(failure):
                raise StorageChanged(redacted(self.url)) from None
            raise
        if len(data) != end - start:
            raise StorageFailed(redacted(self.url), f"{len(data)} bytes received, {end - start} requested")
        return bytes(data)

    def stream(self) -> Iterator[bytes]:
        """All bytes from the first on, in blocks. Raises StorageFailed, StorageChanged."""
        size = self.info.size_bytes or 0
        for start in range(0, size, _STREAMED_BYTES):
            yield self.fetch(start, min(start + _STREAMED_BYTES, size))


def _is_unmet_condition(error: BaseException) -> bool:
    """Whether a store refused to read another version; s3fs itself knows it by the words of Amazon's answer alone."""
    cause: BaseException | None = error
    while cause is not None:
        answer = getattr(cause, "response", None)
        code = answer.get("Error", {}).get("Code") if isinstance(answer, dict) else None
        if type(cause).__name__ == "FileExpired" or code in ("PreconditionFailed", "412"):
            return True
        cause = cause.__cause__ or cause.__context__
    return False


def object_info(info: Mapping[str, Any]) -> ObjectInfo:
    """The metadata in fsspec's info of a file; each system has its own names for the version."""
    size = info.get("size")
    etag = next((str(info[name]) for name in ("ETag", "etag", "md5Hash", "content_md5") if info.get(name)), None)
    times = ("LastModified", "last_modified", "updated", "mtime", "modified", "created")
    modified = next((str(info[name]) for name in times if info.get(name)), None)
    return ObjectInfo(size if isinstance(size, int) and size >= 0 else None, True, etag, modified)


_KNOWN = "there are s3, http, https, gs, abfs, sftp and others of fsspec"


def filesystem(url: str) -> Any:
    """The file system of fsspec for a URL, with bounded patience. Raises FileError, StorageFailed."""
    protocol = protocol_of(url)
    try:
        with explained(url):
            # Whether a URL is quoted already decides what is sent: a signature must arrive as it was made.
            return _filesystem(protocol, url.isascii() and " " not in url, _login(protocol, url))
    except StorageFailed as failure:
        if isinstance(failure.__cause__, ImportError):
            remedy = "pip install 'quadlog[s3]'" if protocol in ("s3", "s3a") else failure.reason
            raise FileError(redacted(url), f"{protocol}:// needs another package: {remedy}") from None
        if isinstance(failure.__cause__, ValueError):
            raise FileError(redacted(url), f"unknown protocol {protocol!r}; {_KNOWN}") from None
        if isinstance(failure.__cause__, TypeError):
            # Its class asks for more than its options.
            raise FileError(redacted(url), f"{protocol}:// is not a protocol that quadlog reads; {_KNOWN}") from None
        raise


def _login(protocol: str, url: str) -> tuple[tuple[str, Any], ...]:
    """The server and the user that a URL names, for systems like ftp that have one connection for each."""
    import fsspec

    found = fsspec.get_filesystem_class(protocol)._get_kwargs_from_urls(url)
    return tuple((name, found[name]) for name in ("host", "port", "username", "password") if found.get(name))


def _filesystem(protocol: str, quoted: bool, login: tuple[tuple[str, Any], ...]) -> Any:
    import fsspec

    system = fsspec.get_filesystem_class(protocol)(**_patience(protocol, quoted), **dict(login))
    if hasattr(system, "call_s3"):
        system.retries = _TRIES
    return system


def _patience(protocol: str, quoted: bool) -> dict[str, Any]:
    """Options that bound every wait; what the user's own fsspec configuration says stays."""
    from fsspec.config import conf

    own = conf.get(protocol, {})
    if protocol in ("http", "https"):
        import aiohttp

        timeout = aiohttp.ClientTimeout(total=None, sock_connect=CONNECT_S, sock_read=READ_S)
        # trust_env: proxies and .netrc, as every other tool takes them.
        client = {"timeout": timeout, "trust_env": True, **own.get("client_kwargs", {})}
        return {"client_kwargs": client, "encoded": quoted}
    if protocol in ("s3", "s3a"):
        retries = {"total_max_attempts": _TRIES_WITHIN, "mode": "standard"}
        waits = {"connect_timeout": CONNECT_S, "read_timeout": READ_S, "retries": retries}
        # Listings are not cached: another machine may be writing there.
        return {"config_kwargs": {**waits, **own.get("config_kwargs", {})}, "use_listings_cache": False}
    return {}


_CONTENT_RANGE = re.compile(r"bytes (?:(\d{1,18})-(\d{1,18})|\*)/(\d{1,18})")
_WAITS_S = (0.1, 0.5, 2.0)
_SLOWEST_BYTES_PER_S = 20_000
_PATIENCE_S = 60.0
_BLOCK_BYTES = 1 << 20


class _Again(Exception):
    """An answer that a second try may mend."""


class WebObject:
    """A file behind http:// or https://, as BucketObject."""

    def __init__(self, url: str) -> None:
        self.url = url
        self._web = filesystem(url)
        with explained(url):
            self.info = self._run(self._probe())

    def fetch(self, start: int, end: int) -> bytes:
        with self._still_there():
            return self._run(self._fetch(start, end))

    def stream(self) -> Iterator[bytes]:
        with self._still_there():
            response = self._run(self._begin(self._condition(), None))
            try:
                if response.status != 200:
                    self._refuse(response)
                if response.headers.get("ETag") != self.info.etag:
                    raise StorageChanged(redacted(self.url))
                whole = response.headers.get("Content-Encoding", "identity") == "identity"
                self._compare(response, response.content_length if whole else None)
                while block := self._run(response.content.read(_BLOCK_BYTES)):
                    yield block
            finally:
                response.close()

    @contextmanager
    def _still_there(self) -> Iterator[None]:
        """What was opened and is gone has changed: a FileNotFoundError would be taken for damage of a disk."""
        try:
            with explained(self.url):
                yield
        except FileNotFoundError:
            raise StorageChanged(redacted(self.url)) from None

    def _condition(self) -> dict[str, str]:
        """Headers with which a server that knows conditions refuses to answer from another file."""
        if self.info.etag is not None and not self.info.etag.startswith("W/"):
            return {"If-Match": self.info.etag}
        return {"If-Unmodified-Since": self.info.last_modified} if self.info.last_modified else {}

    def _compare(self, response: Any, size: int | None) -> None:
        """Raise StorageChanged for a response with another size or version of the whole file."""
        etag = response.headers.get("ETag", self.info.etag)
        # The date also beside equal ETags: some servers make theirs of the size alone.
        now, then = response.headers.get("Last-Modified"), self.info.last_modified
        other_size = None not in (size, self.info.size_bytes) and size != self.info.size_bytes
        if other_size or etag != self.info.etag or (now and then and now != then):
            raise StorageChanged(redacted(self.url))

    def _run(self, coroutine: Any) -> Any:
        from fsspec.asyn import sync

        async def wait() -> Any:
            return await coroutine

        return sync(self._web.loop, wait)

    async def _begin(self, headers: dict[str, str], size: int | None) -> Any:
        """The response once its headers are there, the body unread."""
        import aiohttp

        session = await self._web.set_session()
        options = {name: value for name, value in self._web.kwargs.items() if name != "headers"}
        # Never compressed: lengths and offsets are those of the file itself.
        sent = {**self._web.kwargs.get("headers", {}), "Accept-Encoding": "identity", **headers}
        if size is not None:
            longest_s = _PATIENCE_S + size / _SLOWEST_BYTES_PER_S
            options["timeout"] = aiohttp.ClientTimeout(total=longest_s, sock_connect=CONNECT_S, sock_read=READ_S)
        return await session.get(self._web.encode_url(self.url), headers=sent, **options)

    async def _probe(self) -> ObjectInfo:
        """Request one byte for size, version and support of ranges: a signature may allow GET alone."""

        async def look(response: Any) -> ObjectInfo:
            """What the answer to a question for one byte says of the whole."""
            version = {"etag": response.headers.get("ETag"), "last_modified": response.headers.get("Last-Modified")}
            if response.status == 206:
                _, _, size = self._content_range(response)
                return ObjectInfo(size, ranges=True, **version)
            if response.status == 416:
                found = _CONTENT_RANGE.fullmatch(response.headers.get("Content-Range", ""))
                return ObjectInfo(int(found[3]) if found else 0, ranges=bool(found), **version)
            whole = response.headers.get("Content-Encoding", "identity") == "identity"
            return ObjectInfo(response.content_length if whole else None, ranges=False, **version)

        return await self._try({"Range": "bytes=0-0"}, 1, look, fine=(200, 206, 416))

    async def _fetch(self, start: int, end: int) -> bytes:
        async def take(response: Any) -> bytes:
            """The body of a response with the requested range of the same file."""
            first, last, size = self._content_range(response)
            self._compare(response, size)
            if (first, last) != (start, end - 1):
                raise StorageFailed(redacted(self.url), "the server returned another range than requested")
            return await response.content.readexactly(end - start)

        headers = {"Range": f"bytes={start}-{end - 1}", **self._condition()}
        return await self._try(headers, end - start, take, fine=(206,))

    async def _try(self, headers: dict[str, str], size: int, take: Any, fine: tuple[int, ...]) -> Any:
        """What `take` makes of an answer with a fine status; a few tries where waiting may help."""
        import asyncio

        import aiohttp

        hopeless = (aiohttp.ClientConnectorDNSError, aiohttp.InvalidURL, aiohttp.ClientConnectorCertificateError)
        final = (*hopeless, FileNotFoundError)
        for wait_s in _WAITS_S:
            try:
                return await self._ask(headers, size, take, fine)
            except final:
                raise
            except (_Again, aiohttp.ClientConnectionError, aiohttp.ClientPayloadError, EOFError, OSError):
                await asyncio.sleep(wait_s)
        try:
            return await self._ask(headers, size, take, fine)
        except (aiohttp.ClientPayloadError, EOFError) as error:
            raise StorageFailed(redacted(self.url), "the server ends its answers too early") from error
        except _Again as error:
            raise StorageFailed(redacted(self.url), f"{error}, {len(_WAITS_S) + 1} times") from error

    async def _ask(self, headers: dict[str, str], size: int, take: Any, fine: tuple[int, ...]) -> Any:
        response = await self._begin(headers, size)
        try:
            if response.status >= 500 or response.status == 429:
                raise _Again(f"the server answers with status {response.status}")
            if response.status not in fine:
                self._refuse(response)
            return await take(response)
        finally:
            # A whole file that was not requested is not read to its end.
            if response.status == 206:
                response.release()
            else:
                response.close()

    def _refuse(self, response: Any) -> None:
        """Raise what an answer without content means."""
        if response.status in (404, 410):
            raise FileNotFoundError(redacted(self.url))
        found = _CONTENT_RANGE.fullmatch(response.headers.get("Content-Range", ""))
        if response.status == 412 or (response.status == 416 and found and int(found[3]) != self.info.size_bytes):
            raise StorageChanged(redacted(self.url))
        response.raise_for_status()
        if response.status == 200:
            # Ranges were understood a moment ago: with If-Match this is another file, without it another server.
            raise StorageChanged(redacted(self.url))
        raise StorageFailed(redacted(self.url), f"the server answers with status {response.status}")

    def _content_range(self, response: Any) -> tuple[int, int, int]:
        found = _CONTENT_RANGE.fullmatch(response.headers.get("Content-Range", ""))
        if found is None or found[1] is None or response.headers.get("Content-Encoding", "identity") != "identity":
            raise StorageFailed(redacted(self.url), "the server sent a part without its range")
        first, last, size = int(found[1]), int(found[2]), int(found[3])
        if not first <= last < size:
            raise StorageFailed(redacted(self.url), "the server sent a range outside the file")
        return first, last, size


RemoteObject = BucketObject | WebObject
