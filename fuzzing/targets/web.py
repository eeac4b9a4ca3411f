"""A web server on loopback that serves an undamaged recording with arbitrary response headers."""

from __future__ import annotations

import re
import socketserver
import threading
from functools import cache
from pathlib import Path

from fuzzing import seeds
from fuzzing.oracles import expect
from quadlog.recordings.containers.open import open_container
from quadlog.storage import remote_object as web_object
from quadlog.storage.remote_path import to_path

_RANGE = re.compile(rb"[Rr]ange: bytes=(\d+)-(\d+)")
_HEADS = (
    (
        "HTTP/1.1 206 Partial Content\r\nContent-Range: bytes {first}-{last}/{size}\r\nContent-Length: {length}\r\n"
        'ETag: "a"\r\nLast-Modified: Mon, 01 Jan 2024 00:00:00 GMT\r\nAccept-Ranges: bytes\r\n\r\n'
    ),
    'HTTP/1.1 200 OK\r\nContent-Length: {size}\r\nETag: W/"a"\r\n\r\n',
    "HTTP/1.1 206 Partial Content\r\nContent-Range: bytes {first}-{last}/{size}\r\nTransfer-Encoding: chunked\r\n\r\n",
    "HTTP/1.1 200 OK\r\nContent-Encoding: gzip\r\n\r\n",
    "HTTP/1.1 416 Range Not Satisfiable\r\nContent-Range: bytes */{size}\r\nContent-Length: 0\r\n\r\n",
    "HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n",
    "HTTP/1.1 503 Service Unavailable\r\nRetry-After: 9\r\nContent-Length: 0\r\n\r\n",
)
_CUT = 0x80


class _Handler(socketserver.BaseRequestHandler):
    """One response a connection; `head` is used from the `after`-th one on, and with `cut` the body ends early."""

    head, after, cut, asked = b"", 0, False, 0

    def handle(self) -> None:
        kind = type(self)
        request = b""
        while b"\r\n\r\n" not in request and (more := self.request.recv(4096)):
            request += more
        found = _RANGE.search(request)
        whole = seeds.recordings()["mcap"]
        first, last = (int(found[1]), min(int(found[2]), len(whole) - 1)) if found else (0, len(whole) - 1)
        head = kind.head if kind.asked >= kind.after else _HEADS[0].encode()
        kind.asked += 1
        body = whole[first : last + 1] if b" 206" in head[:20] else whole
        told = {"first": first, "last": last, "size": len(whole), "length": len(body)}
        for name, value in told.items():
            head = head.replace(b"{%s}" % name.encode(), str(value).encode())
        self.request.sendall(head + body[: len(body) // 2 if kind.cut else None])


@cache
def _port() -> int:
    server = socketserver.ThreadingTCPServer(("127.0.0.1", 0), _Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    web_object._WAITS_S = (0.0,)  # type: ignore[assignment] # the waits are for people's servers
    return server.server_address[1]


def answers(folder: Path, data: bytes) -> None:
    """Any response head, from the n-th response on: messages are those of the file, and missing ones are a loss."""
    port = _port()
    flags = (data or b"\0")[0]
    # No redirect to another server.
    _Handler.head = re.sub(rb"(?i)location|refresh|set-cookie", b"X-Other", data[1:])
    _Handler.after, _Handler.cut, _Handler.asked = flags & 3, bool(flags & _CUT), 0
    with open_container(to_path(f"http://127.0.0.1:{port}/walk.mcap")) as container:
        found = sum(1 for _ in container.messages())
        expect(found <= seeds.MESSAGES, f"{found} messages of {seeds.MESSAGES}")
        expect(found == seeds.MESSAGES or bool(container.losses), f"{found} of {seeds.MESSAGES} messages and no loss")


def answer_seeds() -> list[bytes]:
    """Every head, from the first response on or after two valid ones, with a whole and a truncated body."""
    return [bytes([flags]) + head.encode() for head in _HEADS for flags in (0, 2, _CUT, _CUT | 2)]
