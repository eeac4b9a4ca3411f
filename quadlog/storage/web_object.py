"""A file on a web server: asked for by ranges, and never believed without a look at what the answer says of itself."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from quadlog.errors import StorageChanged, StorageFailed
from quadlog.storage.failures import explained
from quadlog.storage.remote_object import CONNECT_S, READ_S, Told, filesystem
from quadlog.storage.urls import redacted

_CONTENT_RANGE = re.compile(r"bytes (?:(\d{1,18})-(\d{1,18})|\*)/(\d{1,18})")
_WAITS_S = (0.1, 0.5, 2.0)
_SLOWEST_BYTES_PER_S = 20_000
_PATIENCE_S = 60.0
_BLOCK_BYTES = 1 << 20


class _Again(Exception):
    """An answer that a second try may mend."""


class WebObject:
    """A file behind http:// or https:// (RemoteObject)."""

    def __init__(self, url: str) -> None:
        self.url = url
        self._web = filesystem(url)
        with explained(url):
            self.told = self._run(self._probe())

    def fetch(self, start: int, end: int) -> bytes:
        """The bytes from start to end, end excluded. Raises StorageFailed, StorageChanged."""
        with self._still_there():
            return self._run(self._fetch(start, end))

    def stream(self) -> Iterator[bytes]:
        """All bytes from the first on, in blocks. Raises StorageFailed, StorageChanged."""
        with self._still_there():
            response = self._run(self._begin(self._condition(), None))
            try:
                if response.status != 200:
                    self._refuse(response)
                if response.headers.get("ETag") != self.told.etag:
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
        if self.told.etag is not None and not self.told.etag.startswith("W/"):
            return {"If-Match": self.told.etag}
        return {"If-Unmodified-Since": self.told.last_modified} if self.told.last_modified else {}

    def _compare(self, response: Any, size: int | None) -> None:
        """Raise StorageChanged for an answer that tells another size or version of the whole file."""
        etag = response.headers.get("ETag", self.told.etag)
        # The date also beside equal ETags: some servers make theirs of the size alone.
        now, then = response.headers.get("Last-Modified"), self.told.last_modified
        other_size = None not in (size, self.told.size_bytes) and size != self.told.size_bytes
        if other_size or etag != self.told.etag or (now and then and now != then):
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

    async def _probe(self) -> Told:
        """One byte tells size, version and whether ranges are understood, also where a signature allows GET alone."""

        async def look(response: Any) -> Told:
            """What the answer to a question for one byte says of the whole."""
            version = {"etag": response.headers.get("ETag"), "last_modified": response.headers.get("Last-Modified")}
            if response.status == 206:
                _, _, size = self._content_range(response)
                return Told(size, ranges=True, **version)
            if response.status == 416:
                found = _CONTENT_RANGE.fullmatch(response.headers.get("Content-Range", ""))
                return Told(int(found[3]) if found else 0, ranges=bool(found), **version)
            whole = response.headers.get("Content-Encoding", "identity") == "identity"
            return Told(response.content_length if whole else None, ranges=False, **version)

        return await self._try({"Range": "bytes=0-0"}, 1, look, fine=(200, 206, 416))

    async def _fetch(self, start: int, end: int) -> bytes:
        async def take(response: Any) -> bytes:
            """The body, once the answer says that it is the stretch asked for, of the same file."""
            first, last, size = self._content_range(response)
            self._compare(response, size)
            if (first, last) != (start, end - 1):
                raise StorageFailed(redacted(self.url), "the server answers with another range than it was asked for")
            return await response.content.readexactly(end - start)

        headers = {"Range": f"bytes={start}-{end - 1}", **self._condition()}
        return await self._try(headers, end - start, take, fine=(206,))

    async def _try(self, headers: dict[str, str], size: int, take: Any, fine: tuple[int, ...]) -> Any:
        """What `take` makes of an answer with a fine status; a few tries where waiting may help."""
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
            # A whole file that nobody asked for is not read to its end.
            if response.status == 206:
                response.release()
            else:
                response.close()

    def _refuse(self, response: Any) -> None:
        """Raise what an answer without content means."""
        if response.status in (404, 410):
            raise FileNotFoundError(redacted(self.url))
        found = _CONTENT_RANGE.fullmatch(response.headers.get("Content-Range", ""))
        if response.status == 412 or (response.status == 416 and found and int(found[3]) != self.told.size_bytes):
            raise StorageChanged(redacted(self.url))
        response.raise_for_status()
        if response.status == 200:
            # Ranges were understood a moment ago: with If-Match this is another file, without it another server.
            raise StorageChanged(redacted(self.url))
        raise StorageFailed(redacted(self.url), f"the server answers with status {response.status}")

    def _content_range(self, response: Any) -> tuple[int, int, int]:
        found = _CONTENT_RANGE.fullmatch(response.headers.get("Content-Range", ""))
        if found is None or found[1] is None or response.headers.get("Content-Encoding", "identity") != "identity":
            raise StorageFailed(redacted(self.url), "the server sends a part without saying which")
        first, last, size = int(found[1]), int(found[2]), int(found[3])
        if not first <= last < size:
            raise StorageFailed(redacted(self.url), "the server sends a part that lies outside the file")
        return first, last, size
