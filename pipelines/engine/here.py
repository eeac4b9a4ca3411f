"""The executor that is this very process."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import ParamSpec, TypeVar

from quadlog.pipelines.engine.telling import Listener, told_to

P = ParamSpec("P")
T = TypeVar("T")


class Here(Executor):
    """Calls at once whatever is submitted; its future is done. Ctrl-C amid a call is raised where it was submitted."""

    def __init__(self, listener: Listener | None = None) -> None:
        self._listener = listener

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """The done future of a call."""
        future: Future[T] = Future()
        try:
            with told_to(self._listener):
                future.set_result(fn(*args, **kwargs))
        except Exception as error:  # whoever asks for the result gets it
            future.set_exception(error)
        return future
