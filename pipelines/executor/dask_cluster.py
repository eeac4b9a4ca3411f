"""An executor on the workers of a running Dask cluster, given by its scheduler's address."""

from __future__ import annotations

import asyncio
import logging
import os
import platform
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from importlib import import_module, metadata
from typing import Any, ParamSpec, TypeVar
from urllib.parse import urljoin
from uuid import uuid4

from quadlog.errors import ClusterUnusable, ClusterWorkersDied, VersionsDiffer
from quadlog.pipelines.executor.progress import Listener, told_to

PYTHON = "Python"
DECISIVE = ("quadlog", "numpy", "scipy", "numba", "llvmlite", "mujoco", "daqp", "quadprog", "pyarrow")
"""Packages whose version can change the bytes of results: arithmetic, compilers, solvers, and the table writer."""

# One replay at a time for each process, whatever its threads: module-level work arrays and memory limits assume it.
# A lock, because Dask's resources would have to be configured when a worker starts.
_one_at_a_time = threading.Lock()
_stopped: set[str] = set()


class Stopped(Exception):
    """The task has been stopped."""


def do_task(topic: str, versions: Mapping[str, str], call: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Any:
    """Run a call on a worker; its messages go to a topic of the scheduler's events.

    Raises VersionsDiffer on a worker with other versions, Stopped after `stop_tasks`, and what call raises.
    """
    from distributed import get_worker

    worker = get_worker()
    check_versions(str(worker.address), versions, own_versions())
    os.environ.setdefault("MUJOCO_GL", "disable")  # as the command line has it: nothing here draws with it

    def pass_on(message: Any) -> None:
        if topic in _stopped:
            raise Stopped
        worker.log_event(topic, message)

    with _one_at_a_time, told_to(pass_on, str(worker.address)):
        if topic in _stopped:
            raise Stopped
        return call(*args, **kwargs)


def stop_tasks(topic: str) -> None:
    """Tasks of this topic, which belongs to one command, end with their next message."""
    _stopped.add(topic)


def own_versions() -> dict[str, str]:
    """Versions of Python, without its patch number, and of DECISIVE; "none" where one is not installed."""
    found = {PYTHON: minor(platform.python_version())}
    for name in DECISIVE:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "none"
    return found


def minor(version: str) -> str:
    """3.12 of 3.12.4: patch releases give the same pickles and results."""
    return ".".join(version.split(".")[:2])


def check_versions(worker: str, wanted: Mapping[str, str], found: Mapping[str, str]) -> None:
    """Raises VersionsDiffer when a worker has other versions than this process."""
    differing = [(name, found.get(name, "none"), wanted[name]) for name in wanted if found.get(name) != wanted[name]]
    if differing:
        raise VersionsDiffer(worker, differing)


ANSWER_S = 10.0
"""Time-out of the scheduler and its workers."""
PAGE_S = 2.0
"""Time-out of the dashboard, whose address is shown even then."""
PLOTS = "individual-plots.json"
"""The page that lists a dashboard's plots."""

P = ParamSpec("P")
T = TypeVar("T")


class Cluster(Executor):
    """An executor of a cluster's workers. Dask restarts the task of a worker that dies, by its own settings."""

    def __init__(self, client: Any, address: str, listener: Listener) -> None:
        """client: connected to the scheduler of this address. Raises VersionsDiffer."""
        self._client, self._address = client, address
        self._topic = f"quadlog-{uuid4().hex}"
        self._versions = own_versions()
        self._check_workers()
        # Not pure: the same recording again is to be replayed again.
        self._executor: Executor = client.get_executor(pure=False)
        client.subscribe_topic(self._topic, lambda event: listener(event[1]))

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """The future of a call on one of the workers."""
        given: Future[T] = self._executor.submit(do_task, self._topic, self._versions, fn, *args, **kwargs)
        future: Future[T] = Future()
        given.add_done_callback(lambda given: _pass_on(given, future))
        return future

    def workers(self) -> int:
        """Number of workers now. Raises ClusterUnusable when the scheduler does not answer."""
        return len(self._ask(self._client.nthreads))

    def room(self) -> int:
        """Tasks to hand out: two for each worker, or one if it has several threads, which would wait for the lock."""
        return sum(2 if threads == 1 else 1 for threads in self._ask(self._client.nthreads).values())

    def stop(self) -> None:
        """Cancel queued tasks; running ones end with their next message."""
        with suppress(Exception):  # the cluster may be gone
            self._client.run(stop_tasks, self._topic, on_error="ignore")
        with suppress(Exception):
            self._executor.shutdown(wait=False)

    @property
    def greeting(self) -> str:
        """Number of workers, and the address of the dashboard."""
        workers = self.workers()
        many = "1 worker" if workers == 1 else f"{workers} workers"
        served = "dashboard" in self._client.scheduler_info().get("services", {})
        link = self._client.dashboard_link if served else None
        return many if link is None or _is_missing(link) else f"{many}; dashboard: {link}"

    def _check_workers(self) -> None:
        """Check all workers, with functions of the standard library; later ones are checked by `do_task`."""
        found: dict[str, dict[str, str]] = {}
        for name in self._versions:
            ask = (platform.python_version,) if name == PYTHON else (metadata.version, name)
            for worker, version in self._ask(self._client.run, *ask, on_error="return").items():
                if isinstance(version, str):
                    found.setdefault(worker, {})[name] = minor(version) if name == PYTHON else version
                elif isinstance(version, metadata.PackageNotFoundError):
                    found.setdefault(worker, {})[name] = "none"
        for worker in sorted(found):
            if len(found[worker]) == len(self._versions):
                check_versions(worker, self._versions, found[worker])

    def _ask(self, question: Callable[..., T], *args: Any, **kwargs: Any) -> T:
        try:
            return question(*args, **kwargs)
        except (OSError, TimeoutError) as error:
            raise ClusterUnusable(self._address, f"does not answer any more ({_one_line(error)})") from error


@contextmanager
def open_cluster(address: str, listener: Listener) -> Iterator[Cluster]:
    """The cluster of a scheduler's address; after an error its tasks are stopped.

    Raises ClusterUnusable when Dask is not installed or the scheduler does not answer, VersionsDiffer.
    """
    try:
        dask = import_module("distributed")
    except ImportError:
        raise ClusterUnusable(address, "needs Dask: pip install distributed bokeh") from None
    _check_scheduler(dask, address)
    with _silent_loggers(), dask.Client(address, timeout=ANSWER_S, set_as_default=False) as client:
        cluster = Cluster(client, address, listener)
        try:
            yield cluster
        except BaseException:
            cluster.stop()
            raise


@contextmanager
def _silent_loggers() -> Iterator[None]:
    """Switch off Dask's log, which prints a traceback for each error reported here in one line."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def _check_scheduler(dask: Any, address: str) -> None:
    """Raises ClusterUnusable; Dask's client would wait forever for a server that accepts and does not answer."""

    async def identity() -> dict[str, Any]:
        async with dask.rpc(address, connection_args=dask.Security().get_connection_args("client")) as there:
            return await asyncio.wait_for(there.identity(), ANSWER_S)

    try:
        kind = asyncio.run(identity())["type"]
    except (ValueError, TypeError) as error:  # no address, or one of a kind that is not set up
        raise ClusterUnusable(address, f"is no address of a Dask scheduler ({_one_line(error)})") from None
    except OSError:
        raise ClusterUnusable(address, f"no Dask scheduler has answered within {ANSWER_S:g} s") from None
    if kind != "Scheduler":
        raise ClusterUnusable(address, f"is a Dask {kind.lower()}, not the scheduler")


def _is_missing(page: str) -> bool:
    """Whether the dashboard has no plots: without Bokeh the scheduler still gives its address.

    False where it cannot be reached from here, since the user's browser may.
    """
    import aiohttp

    async def plots() -> object:
        longest = aiohttp.ClientTimeout(total=PAGE_S)
        async with aiohttp.ClientSession(timeout=longest) as session, session.get(urljoin(page, PLOTS)) as answer:
            return await answer.json() if answer.ok else None

    try:
        return asyncio.run(plots()) == {}
    except (OSError, ValueError, aiohttp.ClientError):
        return False


def _pass_on(given: Future[T], future: Future[T]) -> None:
    """Copy the result or error to the other future; KilledWorker becomes ClusterWorkersDied."""
    from distributed import KilledWorker

    error = None if given.cancelled() else given.exception()
    if given.cancelled() or isinstance(error, Stopped):
        future.cancel()
        future.set_running_or_notify_cancel()
    elif error is None:
        future.set_result(given.result())
    elif isinstance(error, KilledWorker):
        future.set_exception(ClusterWorkersDied(error.allowed_failures + 1, str(error.last_worker.address)))
    else:
        future.set_exception(error)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
