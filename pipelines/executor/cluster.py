"""The workers of a running Dask cluster, given by its scheduler's address, as an executor."""

from __future__ import annotations

import asyncio
import logging
import os
import platform
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from queue import SimpleQueue
from typing import Any
from uuid import uuid4

from quadlog.config.version import package_versions
from quadlog.errors import QuadlogError, VersionsDiffer
from quadlog.pipelines.executor.pool import Workers
from quadlog.pipelines.executor.progress import send_to
from quadlog.version import __version__

ANSWER_S = 10.0
"""Time-out of the scheduler and its workers."""

# One replay at a time for each process, whatever its threads: module-level work arrays and memory limits assume it.
# A lock, because Dask's resources would have to be configured when a worker starts.
_one_at_a_time = threading.Lock()
_stopped: set[str] = set()


class Stopped(BaseException):
    """The task has been stopped."""


def do_task(topic: str, versions: Mapping[str, str], call: Callable[..., Any], /, *args: Any) -> Any:
    """Run a call on a worker; its progress goes to a topic of the scheduler's events.

    Raises VersionsDiffer on a worker with other versions, Stopped after `stop_tasks`, and what call raises.
    """
    from distributed import get_worker

    worker = get_worker()
    check_versions(str(worker.address), versions, own_versions())
    os.environ.setdefault("MUJOCO_GL", "disable")  # as the command line has it: nothing here draws with it

    def send(message: Any) -> None:
        if topic in _stopped:
            raise Stopped
        worker.log_event(topic, message)

    with _one_at_a_time:
        if topic in _stopped:
            raise Stopped
        send_to(send, str(worker.address))
        try:
            return call(*args)
        finally:
            send_to(None)


def stop_tasks(topic: str) -> None:
    """Tasks of this topic, which belongs to one command, end with their next message."""
    _stopped.add(topic)


def own_versions() -> dict[str, str]:
    """Versions of quadlog, Python and the packages that results depend on; patch releases of Python do not matter."""
    python = ".".join(platform.python_version_tuple()[:2])
    return {"quadlog": __version__, "Python": python, **package_versions()}


def check_versions(worker: str, wanted: Mapping[str, str], found: Mapping[str, str]) -> None:
    """Raises VersionsDiffer when a worker has other versions than this process."""
    differing = [name for name in wanted if found.get(name) != wanted[name]]
    if differing:
        words = ", ".join(f"{name} {found.get(name, 'none')} instead of {wanted[name]}" for name in differing)
        raise VersionsDiffer(f"worker {worker} has {words}; install there what is installed here")


@contextmanager
def open_cluster(address: str) -> Iterator[Workers]:
    """The workers of a scheduler; after an error in the block their tasks are stopped. Dask itself tries tasks again.

    Raises QuadlogError when Dask is not installed, the scheduler does not answer or a worker cannot load quadlog;
    VersionsDiffer.
    """
    try:
        dask = import_module("distributed")
    except ImportError:
        raise QuadlogError(f"--scheduler {address}: needs Dask: pip install 'quadlog[cluster]'") from None
    _check_scheduler(dask, address)
    topic, versions = f"quadlog-{uuid4().hex}", own_versions()
    messages: SimpleQueue[Any] = SimpleQueue()
    # Dask's log prints a traceback for each error that is reported here in one line.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with dask.Client(address, timeout=ANSWER_S, set_as_default=False) as client:
        for worker, found in sorted(client.run(own_versions, on_error="return").items()):
            if isinstance(found, Exception):
                raise QuadlogError(f"--scheduler {address}: worker {worker} cannot load quadlog ({_one_line(found)})")
            check_versions(worker, versions, found)
        client.subscribe_topic(topic, lambda event: messages.put(event[1]))
        executor = client.get_executor(pure=False)  # the same recording again is to be replayed again

        def stop() -> None:
            with suppress(Exception):  # the cluster may be gone
                client.run(stop_tasks, topic, on_error="ignore")
            with suppress(Exception):
                executor.shutdown(wait=False)

        try:
            yield Workers(
                submit=partial(executor.submit, do_task, topic, versions),
                messages=messages,
                stop=stop,
                count=partial(_count, client),
                death=dask.KilledWorker,
                greeting=f"{_count(client)} workers; dashboard: {client.dashboard_link}",
                address=address,
            )
        except BaseException:
            stop()
            raise


def _count(client: Any) -> int:
    """Number of workers; of a scheduler that has gone, which ends the tasks, what stops nobody."""
    try:
        return len(client.nthreads())
    except (OSError, TimeoutError):
        return 1


def _check_scheduler(dask: Any, address: str) -> None:
    """Raises QuadlogError; Dask's client would wait forever for a server that accepts and does not answer."""

    async def identity() -> dict[str, Any]:
        async with dask.rpc(address, connection_args=dask.Security().get_connection_args("client")) as there:
            return await asyncio.wait_for(there.identity(), ANSWER_S)

    try:
        kind = asyncio.run(identity())["type"]
    except (ValueError, TypeError) as error:  # no address, or one of a kind that is not set up
        raise QuadlogError(f"--scheduler {address}: is no address of a Dask scheduler ({_one_line(error)})") from None
    except OSError:
        raise QuadlogError(f"--scheduler {address}: no Dask scheduler has answered within {ANSWER_S:g} s") from None
    if kind != "Scheduler":
        raise QuadlogError(f"--scheduler {address}: is a Dask {kind.lower()}, not the scheduler")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
