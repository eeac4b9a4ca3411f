"""One object behind a URL: what its server tells of it, and any stretch of its bytes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from email.utils import parsedate_to_datetime
from functools import cache
from typing import Any, Protocol

from quadlog.errors import StorageChanged, StorageFailed, StorageUnknown
from quadlog.storage.failures import explained
from quadlog.storage.urls import protocol_of, redacted

_STREAMED_BYTES = 8 << 20
# Of a server that never answers one knows after a minute and a half.
CONNECT_S, READ_S = 10, 15
_TRIES, _TRIES_WITHIN = 2, 3


@dataclass(frozen=True, slots=True)
class Told:
    """What a server tells: size_bytes None where it does not; ranges: whether it gives parts."""

    size_bytes: int | None
    ranges: bool = True
    etag: str | None = None
    last_modified: str | None = None

    def modified_ns(self) -> int:
        """The time of the last change, 0 where it is not told in a form that is known."""
        for parse in (datetime.fromisoformat, parsedate_to_datetime):
            with suppress(ValueError, TypeError):
                return int(parse(self.last_modified or "").timestamp() * 1e9)
        return 0


class RemoteObject(Protocol):
    """An object as it was when it was opened; told is of that moment."""

    url: str
    told: Told

    def fetch(self, start: int, end: int) -> bytes:
        """The bytes from start to end, end excluded; several threads may ask at once.

        Raises StorageFailed, StorageChanged.
        """
        ...

    def stream(self) -> Iterator[bytes]:
        """All bytes from the first on, in blocks. Raises StorageFailed, StorageChanged."""
        ...


def open_object(url: str) -> RemoteObject:
    """The object behind a URL. Raises FileNotFoundError, StorageUnknown, StorageFailed."""
    protocol = protocol_of(url)
    if protocol in ("http", "https"):
        from quadlog.storage.web_object import WebObject

        return WebObject(url)
    return BucketObject(url)


class BucketObject:
    """An object of S3, or of any other system that fsspec knows (RemoteObject)."""

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
                if told_by(info).etag is None:
                    self._conditional = None
            else:
                info = self._system.info(self._path)
        if info.get("type") != "file":
            raise FileNotFoundError(redacted(url))
        self.told = told_by(info)

    def fetch(self, start: int, end: int) -> bytes:
        """See RemoteObject."""
        try:
            with explained(self.url):
                if self._conditional is not None:
                    data = self._conditional._fetch_range(start, end)
                else:
                    data = self._system.cat_file(self._path, start=start, end=end)
                    # No condition can be sent along, so what is there now is compared after every part.
                    self._system.invalidate_cache(self._path)
                    if told_by(self._system.info(self._path)) != self.told:
                        raise StorageChanged(redacted(self.url))
        except FileNotFoundError:
            raise StorageChanged(redacted(self.url)) from None
        except StorageFailed as failure:
            if _is_unmet_condition(failure):
                raise StorageChanged(redacted(self.url)) from None
            raise
        if len(data) != end - start:
            raise StorageFailed(redacted(self.url), f"{len(data)} bytes came where {end - start} were asked for")
        return bytes(data)

    def stream(self) -> Iterator[bytes]:
        """See RemoteObject."""
        size = self.told.size_bytes or 0
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


def told_by(info: Mapping[str, Any]) -> Told:
    """What fsspec's info of a file tells; each system has names of its own for the version."""
    size = info.get("size")
    etag = next((str(info[name]) for name in ("ETag", "etag", "md5Hash", "content_md5") if info.get(name)), None)
    times = ("LastModified", "last_modified", "updated", "mtime", "modified", "created")
    modified = next((str(info[name]) for name in times if info.get(name)), None)
    return Told(size if isinstance(size, int) and size >= 0 else None, True, etag, modified)


def filesystem(url: str) -> Any:
    """The file system of fsspec for a URL, with bounded patience. Raises StorageUnknown, StorageFailed."""
    protocol = protocol_of(url)
    try:
        with explained(url):
            # Whether a URL is quoted already decides what is sent: a signature must arrive as it was made.
            return _filesystem(protocol, url.isascii() and " " not in url)
    except StorageFailed as failure:
        if isinstance(failure.__cause__, ImportError):
            raise StorageUnknown(redacted(url), f"{protocol}:// needs a package more: {failure.reason}") from None
        if isinstance(failure.__cause__, ValueError):
            known = "s3, http, https, gs, abfs, sftp and others of fsspec"
            raise StorageUnknown(redacted(url), f"unknown protocol {protocol!r}; there are {known}") from None
        raise


@cache
def _filesystem(protocol: str, quoted: bool) -> Any:
    import fsspec

    system = fsspec.get_filesystem_class(protocol)(**_patience(protocol, quoted))
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
        # Listings are asked for anew: another machine may be writing there.
        return {"config_kwargs": {**waits, **own.get("config_kwargs", {})}, "use_listings_cache": False}
    return {}
