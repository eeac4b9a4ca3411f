"""Processes of this machine as an executor, in which one that dies fails only its own task."""

from __future__ import annotations

import atexit
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection
from queue import SimpleQueue
from types import TracebackType
from typing import Any, TypeVar

from quadlog.errors import UsageError, WorkerDied
from quadlog.pipelines.executor.progress import send_to
from quadlog.storage.atomic_write import remove_unfinished

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
# A worker has one core. One heap for all its threads: with glibc's own for each, it grows by 5 % with every recording.
_ENVIRONMENT = dict.fromkeys((*THREAD_VARIABLES, "MALLOC_ARENA_MAX"), "1")
_COPIES = sys.platform == "linux"  # elsewhere libraries of the system need not survive it
_CONTEXT = multiprocessing.get_context("forkserver" if _COPIES else "spawn")
forkserver.set_forkserver_preload(["quadlog.pipelines.executor.preload"])

T = TypeVar("T")


def prepare_workers() -> None:
    """Start the process that loads what workers need, while this one goes on; on Linux each worker is a copy of it.

    It and its copies do not hear Ctrl-C, which reaches all of them: this process's main thread handles it.
    """
    os.environ.update(_ENVIRONMENT)  # libraries look there when they are loaded in a new process
    resource_tracker.ensure_running()  # the thread that starts it has SIGINT unblocked afterwards
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    if _COPIES:
        forkserver.ensure_running()
    signal.pthread_sigmask(signal.SIG_SETMASK, before)


class LocalPool(Executor):
    """A thread for each worker, and in it a pool of one process, so that a death breaks one pool and one task.

    Processes start with their first task and have one thread for BLAS and numba, and temporary files in a folder that
    goes with it. The future of a task whose process has ended raises WorkerDied. An exception in the body of a `with`
    ends all processes at once.
    """

    def __init__(self, workers: int) -> None:
        """The number of processes; `messages` receives what tasks `tell`. UsageError without a working folder."""
        try:
            os.getcwd()  # noqa: PTH109
        except FileNotFoundError:
            raise UsageError("the working folder was removed; start quadlog from one that is there") from None
        self._threads = ThreadPoolExecutor(workers, "quadlog-worker")
        self.messages: SimpleQueue[Any] = SimpleQueue()
        self._own = threading.local()
        self._processes: set[_Process] = set()
        self._stopped = False

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """The future of a queued call. Raises RuntimeError after `shutdown`."""
        return self._threads.submit(self._do, fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more tasks; finish those submitted, or cancel those that have not begun."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for process in list(self._processes) if wait else ():
            process.end()

    def stop(self) -> None:
        """Kill the processes of running tasks and cancel the other tasks, without waiting."""
        self._stopped = True
        self._threads.shutdown(wait=False, cancel_futures=True)  # first, or a free thread would take a waiting task
        for process in list(self._processes):
            process.kill()

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if value is not None:
            self.stop()
        self.shutdown()

    def _do(self, fn: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """In a thread: run a task in its process, which is started unless it is there."""
        try:
            if getattr(self._own, "process", None) is None:
                self._own.process = _Process(self.messages)
                self._processes.add(self._own.process)
                if self._stopped:
                    self._own.process.kill()
            return self._own.process.pool.submit(fn, *args, **kwargs).result()
        except BrokenProcessPool:
            if (process := getattr(self._own, "process", None)) is not None:
                self._processes.discard(process)
                process.end()
                self._own.process = None
            raise WorkerDied("a worker process was killed (out of memory?); fewer --jobs need less") from None


class _Process:
    """A process, its pipe for messages, and its folder for temporary files. Raises BrokenProcessPool."""

    def __init__(self, messages: SimpleQueue[Any]) -> None:
        prepare_workers()
        self._folder = tempfile.TemporaryDirectory(prefix="quadlog-worker-", ignore_cleanup_errors=True)
        reader, writer = _CONTEXT.Pipe(duplex=False)
        with writer:
            self.pool = ProcessPoolExecutor(1, _CONTEXT, _begin, (writer, self._folder.name))
            self._pid = self.pool.submit(os.getpid).result()
        self._listening = threading.Thread(target=_listen, args=(reader, messages), daemon=True)
        self._listening.start()

    def kill(self) -> None:
        with suppress(ProcessLookupError):
            os.kill(self._pid, signal.SIGKILL)

    def end(self) -> None:
        """Wait for its end and its last message, and remove its temporary files."""
        self.pool.shutdown()
        self._listening.join()
        self._folder.cleanup()


def _listen(reader: Connection, messages: SimpleQueue[Any]) -> None:
    """Pass the messages of a process on, until it ends."""
    with reader, suppress(EOFError, OSError):
        while True:
            messages.put(reader.recv())


def _begin(writer: Connection, folder: str) -> None:
    """In a new process: set where messages and temporary files go, and do not outlive a parent that is killed."""
    send_to(writer.send)
    atexit.register(os._exit, 0)  # taking the interpreter down costs half a second
    os.environ["TMPDIR"] = tempfile.tempdir = folder

    def leave_with_parent() -> None:
        parent = multiprocessing.parent_process()
        assert parent is not None
        parent.join()
        remove_unfinished()
        shutil.rmtree(folder, ignore_errors=True)
        os._exit(1)

    threading.Thread(target=leave_with_parent, name="quadlog-orphan", daemon=True).start()


@dataclass(frozen=True, slots=True)
class Workers:
    """Where tasks run. submit: as of an Executor. messages: receives what tasks `tell`, and may take other things.

    stop: end the running tasks and begin no others; their futures end. count: of the workers there are, which may
    change. death: what a future raises whose worker has died, and tries: how often its task is submitted then.
    greeting: a line for the user. address: of the scheduler that workers connect to.
    """

    submit: Callable[..., Future[Any]]
    messages: SimpleQueue[Any]
    stop: Callable[[], None]
    count: Callable[[], int]
    death: type[Exception] = WorkerDied
    tries: int = 1
    greeting: str = ""
    address: str = ""


@contextmanager
def open_executor(jobs: int, scheduler: str | None) -> Iterator[Workers]:
    """`jobs` processes, or the workers of a scheduler's address.

    Tasks never run in this process, so that it survives what kills theirs. Raises what `open_cluster` raises. After an
    error in the block, Ctrl-C among them, all tasks are stopped.
    """
    if scheduler is not None:
        from quadlog.pipelines.executor.cluster import open_cluster

        with open_cluster(scheduler) as workers:
            yield workers
    else:
        with LocalPool(jobs) as pool:
            yield Workers(pool.submit, pool.messages, pool.stop, lambda: jobs, tries=2)
