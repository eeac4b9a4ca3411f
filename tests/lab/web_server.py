"""A web server of a folder, in a thread and on a free port, that counts what it sends."""

from __future__ import annotations

import asyncio
import inspect
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from aiohttp import web

Answer = Callable[[web.Request], Any]


@dataclass
class WebServer:
    """The server's address and the requests it got; `answer` may return a response or an awaitable of one."""

    url: str = ""
    folder: Path = Path()
    requests: list[tuple[str, str, str | None]] = field(default_factory=list)
    sent_bytes: int = 0
    answer: Answer | None = None

    def forget(self) -> None:
        self.requests.clear()
        self.sent_bytes = 0


@contextmanager
def serve(folder: Path) -> Iterator[WebServer]:
    """The files of a folder with ranges and ETags, as aiohttp's own FileResponse sends them."""
    server = WebServer()
    loop = asyncio.new_event_loop()
    started = threading.Event()

    async def handle(request: web.Request) -> web.StreamResponse:
        server.requests.append((request.method, request.path_qs, request.headers.get("Range")))
        special = server.answer(request) if server.answer else None
        if inspect.isawaitable(special):
            special = await special
        if special is not None:
            return special
        path = folder / request.match_info["path"]
        return web.FileResponse(path) if path.is_file() else web.Response(status=404)

    async def count(request: web.Request, response: web.StreamResponse) -> None:
        if request.method != "HEAD":
            server.sent_bytes += response.content_length or 0

    def run() -> None:
        asyncio.set_event_loop(loop)
        app = web.Application()
        app.router.add_route("*", "/{path:.*}", handle)
        app.on_response_prepare.append(count)
        runner = web.AppRunner(app, access_log=None, shutdown_timeout=0)
        loop.run_until_complete(runner.setup())
        site = web.TCPSite(runner, "127.0.0.1", 0)
        loop.run_until_complete(site.start())
        server.url = f"http://127.0.0.1:{runner.addresses[0][1]}"
        started.set()
        loop.run_forever()
        loop.run_until_complete(runner.cleanup())
        loop.close()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    started.wait()
    try:
        yield server
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
