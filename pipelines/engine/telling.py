"""What a task says while it runs: `tell` reaches whoever gave it out, from this process or from another."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from socket import gethostname
from typing import Any

Listener = Callable[[Any], None]
"""Hears what tasks tell, from any thread."""

_listener: Listener | None = None
_name: str | None = None


def tell(message: Any) -> None:
    """Send a message of plain values, as JSON has them. Where nobody listens it is lost, without an error."""
    if _listener is not None:
        _listener(message)


def worker_name() -> str:
    """Who works here: the address of a Dask worker, else host and process id."""
    return _name or f"{gethostname()}:{os.getpid()}"


@contextmanager
def told_to(listener: Listener | None, name: str | None = None) -> Iterator[None]:
    """While the body runs, `tell` calls this function: of the one who listens, or one that passes it on to there."""
    global _listener, _name
    before = _listener, _name
    _listener, _name = listener, name
    try:
        yield
    finally:
        _listener, _name = before
