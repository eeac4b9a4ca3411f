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
    told = {"Content-Range": f"bytes {first}-{min(last, len(data) - 1)}/{len(data)}"}
    return http.Response(status=206, body=data[first : last + 1], headers=told | headers)


def test_ranges_are_the_file_s(web: Any, file: str) -> None:
    remote = WebObject(file)
    assert remote.told.size_bytes == len(CONTENT)
    assert remote.told.ranges
    assert remote.told.etag
    assert remote.told.last_modified
    for start, end in ((0, 1), (17, 70_000), (len(CONTENT) - 5, len(CONTENT))):
        assert remote.fetch(start, end) == CONTENT[start:end]
    assert b"".join(remote.stream()) == CONTENT
    assert web.sent_bytes == 1 + 1 + 70_000 - 17 + 5 + len(CONTENT)
    (web.folder / "empty").touch()
    assert WebObject(f"{web.url}/empty").told.size_bytes == 0


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
    assert (remote.told.ranges, remote.told.size_bytes) == (False, size_bytes)
    if not headers:
        assert b"".join(remote.stream()) == content


def test_temporary_failures_are_retried(web: Any, file: str) -> None:
    remote = WebObject(file)
    answers = iter([http.Response(status=500), http.Response(status=503), http.Response(status=429), None])
    web.answer = lambda _: next(answers)
    assert remote.fetch(5, 70_000) == CONTENT[5:70_000]


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


Answers = dict[str, tuple[Callable[[http.Request], Any], type[QuadlogError], str]]
BOTH: Answers = {
    "always 500": (lambda _: http.Response(status=500), StorageFailed, "status 500"),
    "gone": (lambda _: http.Response(status=404), StorageChanged, "changed"),
    "gone for good": (lambda _: http.Response(status=410), StorageChanged, "changed"),
    "reset": (reset, StorageFailed, "the connection to the server breaks off"),
    "forbidden": (lambda _: http.Response(status=403), StorageFailed, "access is refused"),
}
WHOLE: Answers = BOTH | {
    "other version": (lambda _: http.Response(body=CONTENT, headers={"ETag": '"other"'}), StorageChanged, "changed"),
    "other date": (lambda _: http.Response(body=CONTENT, headers={"Last-Modified": LATER}), StorageChanged, "changed"),
    "other size": (lambda _: http.Response(body=CONTENT + b"more"), StorageChanged, "changed"),
}
PART: Answers = BOTH | {
    "out of order": (lambda _: http.Response(status=503), StorageFailed, "status 503, 4 times"),
    "shorter": (beyond(50), StorageChanged, "changed"),
    "not satisfied": (beyond(len(CONTENT)), StorageFailed, "status 416"),
    "unauthorized": (lambda _: http.Response(status=401), StorageFailed, "access is refused"),
    "teapot": (lambda _: http.Response(status=418), StorageFailed, "status 418"),
    "whole file": (lambda _: http.Response(body=CONTENT), StorageChanged, "changed"),
    "precondition": (lambda _: http.Response(status=412), StorageChanged, "changed"),
    "other version": (lambda r: part(r, ETag='"other"'), StorageChanged, "changed"),
    "other date": (lambda r: part(r, **{"Last-Modified": LATER}), StorageChanged, "changed"),
    "other size": (lambda r: part(r, CONTENT + b"more"), StorageChanged, "changed"),
    "no range": (lambda r: http.Response(status=206, body=CONTENT[:100]), StorageFailed, "without its range"),
    "gzip": (lambda r: part(r, **{"Content-Encoding": "gzip"}), StorageFailed, "without its range"),
    "cut short": (cut_short, StorageFailed, "too early"),
    "nonsense": (
        lambda _: http.Response(status=206, body=b"", headers={"Content-Range": "bytes 9-3/99999999999999999999"}),
        StorageFailed,
        "without its range",
    ),
    "another part": (
        lambda _: http.Response(status=206, body=CONTENT[:90], headers={"Content-Range": f"bytes 0-89/{len(CONTENT)}"}),
        StorageFailed,
        "another range",
    ),
}


@pytest.mark.parametrize(("name", "whole"), [(name, False) for name in PART] + [(name, True) for name in WHOLE])
def test_no_answer_becomes_wrong_bytes(web: Any, file: str, name: str, whole: bool) -> None:
    if whole:
        web.answer = lambda _: http.Response(body=CONTENT, headers={"Last-Modified": EARLIER})
    remote = WebObject(file)
    web.answer, error, words = (WHOLE if whole else PART)[name]
    with pytest.raises(error, match=words) as caught:
        list(remote.stream()) if whole else remote.fetch(10, 100)
    assert "SECRET" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_range_request_has_an_if_match_header(web: Any, file: str) -> None:
    """Also a server that does not repeat the version in its answers."""
    remote, sent = WebObject(file), []
    web.answer = lambda request: sent.append(request.headers.get("If-Match"))
    remote.fetch(0, 10)
    assert sent == [remote.told.etag]


@pytest.mark.parametrize("etag", [None, 'W/"weak"'])
def test_without_a_strong_etag_the_date_is_the_condition(web: Any, file: str, etag: str | None) -> None:
    told = {"Last-Modified": EARLIER} | ({"ETag": etag} if etag else {})
    web.answer = lambda request: part(request, **told)
    remote, sent = WebObject(file), []

    def answer(request: http.Request) -> http.Response:
        sent.append((request.headers.get("If-Match"), request.headers.get("If-Unmodified-Since")))
        return part(request)

    web.answer = answer
    remote.fetch(0, 10)
    assert sent == [(None, EARLIER)]


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


def test_every_wait_has_an_end(web: Any, file: str) -> None:
    """The options of all requests bound the time to connect and between two answers."""
    remote = WebObject(file)
    timeout = remote._web.client_kwargs["timeout"]
    assert 0 < timeout.sock_connect <= 30
    assert 0 < timeout.sock_read <= 30


def test_a_query_arrives_as_it_was_signed(web: Any, file: str) -> None:
    WebObject(f"{web.url}/walk.mcap?X-Credential=a%2Fb%3D&sig=x%2By")
    assert web.requests[-1][1].endswith("?X-Credential=a%2Fb%3D&sig=x%2By")
