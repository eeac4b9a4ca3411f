"""Servers as they are, and as they should not be: what they answer is believed only where it can be right."""

from __future__ import annotations

import gzip
import random
import socket
import struct
from collections.abc import Callable
from typing import Any

import pytest
from aiohttp import web as http

from quadlog.errors import QuadlogError, StorageChanged, StorageFailed
from quadlog.storage import remote_object as web_object
from quadlog.storage.remote_object import WebObject

CONTENT = random.Random(3).randbytes(200_000)
EARLIER, LATER = "Mon, 01 Jan 2024 00:00:00 GMT", "Tue, 02 Jan 2024 00:00:00 GMT"


@pytest.fixture(autouse=True)
def _no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web_object, "_WAITS_S", (0.0, 0.0, 0.0))


@pytest.fixture
def file(web: Any) -> str:
    (web.folder / "walk.mcap").write_bytes(CONTENT)
    return f"{web.url}/walk.mcap?sig=SECRET"


def part(request: http.Request, data: bytes = CONTENT, **headers: str) -> http.Response:
    """The range that was asked for, as a server should answer it."""
    first, last = map(int, request.headers["Range"].removeprefix("bytes=").split("-"))
    content_range = {"Content-Range": f"bytes {first}-{min(last, len(data) - 1)}/{len(data)}"}
    return http.Response(status=206, body=data[first : last + 1], headers=content_range | headers)


def test_ranges_are_the_file_s(web: Any, file: str) -> None:
    remote = WebObject(file)
    assert remote.info.size_bytes == len(CONTENT)
    assert remote.info.ranges
    assert remote.info.etag
    assert remote.info.last_modified
    for start, end in ((0, 1), (17, 70_000), (len(CONTENT) - 5, len(CONTENT))):
        assert remote.fetch(start, end) == CONTENT[start:end]
    assert b"".join(remote.stream()) == CONTENT
    assert web.sent_bytes == 1 + 1 + 70_000 - 17 + 5 + len(CONTENT)
    (web.folder / "empty").touch()
    assert WebObject(f"{web.url}/empty").info.size_bytes == 0


@pytest.mark.parametrize(
    ("content", "headers", "size_bytes"),
    [(b"", {}, 0), (CONTENT, {}, len(CONTENT)), (gzip.compress(CONTENT), {"Content-Encoding": "gzip"}, None)],
)
def test_a_server_without_ranges_says_so_and_is_read_whole(
    web: Any, file: str, content: bytes, headers: dict[str, str], size_bytes: int | None
) -> None:
    """The length of a compressed response is not that of the file."""
    web.answer = lambda _: http.Response(body=content, headers=headers)
    remote = WebObject(file)
    assert (remote.info.ranges, remote.info.size_bytes) == (False, size_bytes)
    if not headers:
        assert b"".join(remote.stream()) == content


def cut_short(request: http.Request) -> http.StreamResponse:
    """Promises the range and ends the connection in the middle of it."""

    class Cut(http.Response):
        async def write_eof(self, data: bytes = b"") -> None:
            await super(http.Response, self).write(CONTENT[:10])
            assert request.transport is not None
            request.transport.close()

    response = part(request)
    return Cut(status=206, body=response.body, headers={"Content-Range": response.headers["Content-Range"]})


def reset(request: http.Request) -> http.Response:
    """Ends the connection as a machine does that knows nothing of it any more."""
    assert request.transport is not None
    request.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    request.transport.abort()
    return http.Response()


def beyond(size: int) -> Callable[[http.Request], http.Response]:
    return lambda _: http.Response(status=416, headers={"Content-Range": f"bytes */{size}"})


Answer = tuple[Callable[[http.Request], Any], type[QuadlogError]]


def status(number: int) -> Callable[[http.Request], http.Response]:
    return lambda _: http.Response(status=number)


def body(data: bytes, status: int = 200, **headers: str) -> Callable[[http.Request], http.Response]:
    named = {key.replace("_", "-"): value for key, value in headers.items()}
    return lambda _: http.Response(status=status, body=data, headers=named)


BOTH: dict[str, Answer] = {
    "always 500": (status(500), StorageFailed),
    "gone": (status(404), StorageChanged),
    "reset": (reset, StorageFailed),
    "forbidden": (status(403), StorageFailed),
}
WHOLE: dict[str, Answer] = BOTH | {
    "other version": (body(CONTENT, ETag='"other"'), StorageChanged),
    "other date": (body(CONTENT, Last_Modified=LATER), StorageChanged),
    "other size": (body(CONTENT + b"more"), StorageChanged),
}
PART: dict[str, Answer] = BOTH | {
    "shorter": (beyond(50), StorageChanged),
    "not satisfied": (beyond(len(CONTENT)), StorageFailed),
    "whole file": (body(CONTENT), StorageChanged),
    "precondition": (status(412), StorageChanged),
    "other version": (lambda r: part(r, ETag='"other"'), StorageChanged),
    "other date": (lambda r: part(r, **{"Last-Modified": LATER}), StorageChanged),
    "other size": (lambda r: part(r, CONTENT + b"more"), StorageChanged),
    "no range": (body(CONTENT[:100], 206), StorageFailed),
    "gzip": (lambda r: part(r, **{"Content-Encoding": "gzip"}), StorageFailed),
    "cut short": (cut_short, StorageFailed),
    "nonsense": (body(b"", 206, Content_Range="bytes 9-3/99999999999999999999"), StorageFailed),
    "another part": (body(CONTENT[:90], 206, Content_Range=f"bytes 0-89/{len(CONTENT)}"), StorageFailed),
}


@pytest.mark.parametrize(("name", "whole"), [(name, False) for name in PART] + [(name, True) for name in WHOLE])
def test_no_answer_becomes_wrong_bytes(web: Any, file: str, name: str, whole: bool) -> None:
    if whole:
        web.answer = lambda _: http.Response(body=CONTENT, headers={"Last-Modified": EARLIER})
    remote = WebObject(file)
    web.answer, error = (WHOLE if whole else PART)[name]
    with pytest.raises(error) as caught:
        list(remote.stream()) if whole else remote.fetch(10, 100)
    assert "SECRET" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_not_retried(web: Any, file: str, closed_port: int) -> None:
    with pytest.raises(FileNotFoundError) as caught:
        WebObject(f"{web.url}/gone?sig=SECRET")
    assert "SECRET" not in str(caught.value)
    remote = WebObject(file)
    (web.folder / "walk.mcap").unlink()
    with pytest.raises(StorageChanged):
        remote.fetch(0, 10)
    # One for the file that never was; one to open the other, one that found it gone.
    assert len(web.requests) == 3
    for url, words in (
        (f"http://127.0.0.1:{closed_port}/x", "cannot be reached"),
        ("http://no-such-host.invalid/x?sig=SECRET", "no such host"),
    ):
        with pytest.raises(StorageFailed, match=words) as caught:
            WebObject(url)
        assert "SECRET" not in str(caught.value)
