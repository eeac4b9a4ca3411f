"""Servers as they are, and as they should not be: what they answer is believed only where it can be right."""

from __future__ import annotations

import gzip
import os
import random
import socket
import struct
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from aiohttp import web as http

from quadlog.errors import QuadlogError, StorageChanged, StorageFailed
from quadlog.storage.remote_object import BLOCK_BYTES, RemoteBytes, info_of

CONTENT = random.Random(3).randbytes(3 * BLOCK_BYTES + 1234)
EARLIER, LATER = "Mon, 01 Jan 2024 00:00:00 GMT", "Tue, 02 Jan 2024 00:00:00 GMT"


@pytest.fixture
def file(web: Any) -> str:
    (web.folder / "walk.mcap").write_bytes(CONTENT)
    return f"{web.url}/walk.mcap?sig=SECRET"


def part(request: http.Request, data: bytes = CONTENT, **headers: str) -> http.Response:
    """The range that was asked for, as a server should answer it."""
    first, last = map(int, request.headers["Range"].removeprefix("bytes=").split("-"))
    content_range = {"Content-Range": f"bytes {first}-{min(last, len(data) - 1)}/{len(data)}"}
    return http.Response(status=206, body=data[first : last + 1], headers=content_range | headers)


def opened(url: str) -> RemoteBytes:
    return RemoteBytes(url, info_of(url))


def test_ranges_are_the_file_s_and_are_fetched_once(web: Any, file: str, monkeypatch: pytest.MonkeyPatch) -> None:
    remote, draw, size = opened(file), random.Random(1), len(CONTENT)
    reads = [(draw.randrange(size + 10), draw.randrange(2 * BLOCK_BYTES)) for _ in range(60)] + [(0, 0), (size, 9)]
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(lambda each: remote.read(*each), reads)) == [CONTENT[a : a + n] for a, n in reads]
    web.forget()
    assert [remote.read(*each) for each in reads] == [CONTENT[a : a + n] for a, n in reads]
    assert web.requests == []
    spans = [(17, 70_000), (5, 0), (size - 5, 99)]
    assert remote.read_each(spans) == [CONTENT[a : a + n] for a, n in spans]
    assert (len(web.requests), web.sent_bytes) == (2, 70_005)
    # A disk that fails here is no damage of a recording there.
    for pread in (lambda *_: b"", lambda *_: os.open("/nowhere", 0)):
        monkeypatch.setattr(os, "pread", pread)
        assert remote.read(0, 10) == CONTENT[:10]
    assert b"".join(remote.stream()) == CONTENT
    assert info_of(file).etag
    assert info_of(file).last_modified
    (web.folder / "empty").touch()
    assert info_of(f"{web.url}/empty").size_bytes == 0


@pytest.mark.parametrize(
    ("content", "headers", "size_bytes"),
    [(b"", {}, 0), (CONTENT, {}, len(CONTENT)), (gzip.compress(CONTENT), {"Content-Encoding": "gzip"}, None)],
)
def test_a_server_without_ranges_says_so_and_is_read_whole(web, file, content, headers, size_bytes):
    """The length of a compressed response is not that of the file."""
    web.answer = lambda _: http.Response(body=content, headers=headers)
    remote, info = opened(file), info_of(file)
    assert (info.ranges, info.size_bytes) == (False, size_bytes)
    assert b"".join(remote.stream()) == (CONTENT if headers else content)


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


def body(data: bytes, status: int = 200, **headers: str) -> Callable[[http.Request], http.Response]:
    named = {key.replace("_", "-"): value for key, value in headers.items()}
    return lambda _: http.Response(status=status, body=data, headers=named)


Answer = tuple[Callable[[http.Request], Any], type[QuadlogError]]
BOTH: dict[str, Answer] = {
    "always 500": (body(b"", 500), StorageFailed),
    "gone": (body(b"", 404), StorageChanged),
    "reset": (reset, StorageFailed),
    "forbidden": (body(b"", 403), StorageFailed),
}
WHOLE: dict[str, Answer] = BOTH | {
    "other version": (body(CONTENT, ETag='"other"'), StorageChanged),
    "other date": (body(CONTENT, Last_Modified=LATER), StorageChanged),
    "other size": (body(CONTENT + b"more"), StorageFailed),
}
PART: dict[str, Answer] = BOTH | {
    "shorter": (body(b"", 416, Content_Range="bytes */50"), StorageChanged),
    "not satisfied": (body(b"", 416, Content_Range=f"bytes */{len(CONTENT)}"), StorageChanged),
    "whole file": (body(CONTENT), StorageChanged),
    "other version": (lambda r: part(r, ETag='"other"'), StorageChanged),
    "other date": (lambda r: part(r, **{"Last-Modified": LATER}), StorageChanged),
    "other size": (lambda r: part(r, CONTENT + b"more"), StorageChanged),
    "no range": (body(CONTENT[:100], 206), StorageFailed),
    "gzip": (lambda r: part(r, **{"Content-Encoding": "gzip"}), StorageFailed),
    "cut short": (cut_short, StorageFailed),
    "nonsense": (body(b"", 206, Content_Range="bytes 9-3/99999999999999999999"), StorageFailed),
    "another part": (
        body(CONTENT[1 : BLOCK_BYTES + 1], 206, Content_Range=f"bytes 1-{BLOCK_BYTES}/{len(CONTENT)}"),
        StorageFailed,
    ),
}


@pytest.mark.parametrize(("name", "whole"), [(name, False) for name in PART] + [(name, True) for name in WHOLE])
def test_no_answer_becomes_wrong_bytes(web: Any, file: str, name: str, whole: bool) -> None:
    if whole:
        web.answer = lambda _: http.Response(body=CONTENT, headers={"Last-Modified": EARLIER})
    remote = opened(file)
    answer, error = (WHOLE if whole else PART)[name]
    sound = error is StorageFailed and not whole  # what the server says of the file itself
    web.answer = lambda request: None if sound and request.headers.get("Range") == "bytes=0-0" else answer(request)
    with pytest.raises(error) as caught:
        list(remote.stream() if whole else (remote.read(10, 90), remote.check_unchanged()))  # type: ignore[func-returns-value]
    assert "SECRET" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_not_retried(web: Any, file: str, closed_port: int) -> None:
    with pytest.raises(FileNotFoundError) as gone:
        info_of(f"{web.url}/gone?sig=SECRET")
    assert "SECRET" not in str(gone.value)
    assert len(web.requests) == 1
    for url, words in (
        (f"http://127.0.0.1:{closed_port}/x", "cannot be reached"),
        ("http://no-such-host.invalid/x?sig=SECRET", "no such host"),
    ):
        with pytest.raises(StorageFailed, match=words) as caught:
            info_of(url)
        assert "SECRET" not in str(caught.value)


def test_an_answer_that_fails_is_tried_three_times(web: Any, file: str) -> None:
    remote = opened(file)
    for failures, fails in ((2, False), (3, True)):
        left = [*range(failures)]
        web.answer = lambda _, left=left: http.Response(status=503) if left and left.pop() >= 0 else None
        if fails:
            with pytest.raises(StorageFailed, match="503"):
                remote.read_each([(0, 10)])
        else:
            assert remote.read_each([(0, 10)]) == [CONTENT[:10]]
