"""One process of `LocalPool`, as seen by the thread that serves it."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess
from multiprocessing.reduction import ForkingPickler
from typing import Any

from quadlog.errors import WorkerDied
from quadlog.pipelines.engine.local_worker import TOLD, serve_tasks
from quadlog.pipelines.engine.telling import Listener

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
# One heap for all threads of a worker: with glibc's own for each, it grows by 5 % with every recording.
_ENVIRONMENT = dict.fromkeys((*THREAD_VARIABLES, "MALLOC_ARENA_MAX"), "1")
Initializer = tuple[Callable[..., object] | None, tuple[Any, ...]]

# The environment is everybody's; and starting a process reaps others, also those that another thread waits for.
_processes = threading.Lock()


class LocalProcess:
    """A spawned process that answers tasks."""

    def __init__(self, initializer: Initializer) -> None:
        """Fresh, because a forked one would inherit locks of libraries' threads."""
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = multiprocessing.Pipe()
        self._process: SpawnProcess = context.Process(target=serve_tasks, args=(theirs, *initializer), daemon=True)
        with _processes, _environment():
            self._process.start()
        theirs.close()

    def answer(self, task: bytes, listener: Listener | None) -> tuple[str, Any]:
        """DONE and the result, or RAISED and the error, of a pickled task. Raises WorkerDied when the process ends."""
        try:
            self._connection.send_bytes(task)
            while True:
                packed = self._connection.recv_bytes()
                kind, value = ForkingPickler.loads(packed)
                if kind != TOLD:
                    return kind, value
                if listener is not None:
                    listener(value)
        except (EOFError, OSError):
            raise WorkerDied(self.end()) from None

    def is_alive(self) -> bool:
        """Whether it can still take a task."""
        with _processes:
            return self._process.is_alive()

    def terminate(self) -> None:
        """Ask it to clean up and end."""
        with _processes:
            self._process.terminate()

    def kill(self) -> None:
        """End it."""
        with _processes:
            self._process.kill()

    def end(self) -> int:
        """Let it go, wait until it has gone, and return its exit code; minus the signal's number if one killed it."""
        self._connection.close()
        wait([self._process.sentinel])
        with _processes:
            self._process.join()
        return self._process.exitcode or 0


@contextmanager
def _environment() -> Iterator[None]:
    """Workers share the cores by tasks, not by threads: set here, because libraries read it when they load."""
    before = {name: os.environ.get(name) for name in _ENVIRONMENT}
    os.environ.update(_ENVIRONMENT)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
