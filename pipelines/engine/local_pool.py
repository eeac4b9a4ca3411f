"""Processes on this machine that take one task each; one that dies costs only its own task."""

from __future__ import annotations

import signal
import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from multiprocessing.reduction import ForkingPickler
from types import TracebackType
from typing import Any, ParamSpec, TypeVar

from quadlog.errors import WorkerDied
from quadlog.pipelines.engine.interrupts import LAST_WORDS_S
from quadlog.pipelines.engine.local_process import LocalProcess
from quadlog.pipelines.engine.local_worker import RAISED
from quadlog.pipelines.engine.telling import Listener

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class _Task:
    future: Future[Any]
    call: Callable[..., Any]
    args: tuple[Any, ...]
    kwargs: dict[str, Any]


class LocalPool(Executor):
    """An executor of spawned processes, each with one thread for BLAS and numba, that takes tasks in their order.

    Every process is served by a thread of this one and is started when there is a task for it. When it dies, be it
    killed or out of memory, its task's future gets WorkerDied and a fresh process takes the next task. Used in a
    `with`, an exception stops all workers at once instead of waiting for them.
    """

    def __init__(
        self,
        workers: int,
        initializer: Callable[..., object] | None = None,
        initargs: tuple[Any, ...] = (),
        listener: Listener | None = None,
    ) -> None:
        """initializer(*initargs) is called in each process before its first task; listener: hears what tasks `tell`."""
        self._workers, self._initializer, self._listener = workers, (initializer, initargs), listener
        self._todo: deque[_Task] = deque()
        self._changed = threading.Condition()
        self._threads: list[threading.Thread] = []
        self._running: set[LocalProcess] = set()
        self._idle = 0
        self._closed = self._stopped = False

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """The future of a call, which waits its turn. Raises RuntimeError after `shutdown`."""
        future: Future[T] = Future()
        with self._changed:
            if self._closed:
                raise RuntimeError("the pool has been shut down")
            self._todo.append(_Task(future, fn, args, kwargs))
            if self._idle < len(self._todo) and len(self._threads) < self._workers:
                thread = threading.Thread(target=self._serve, name="quadlog-worker", daemon=True)
                self._threads.append(thread)
                thread.start()
            self._changed.notify()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more tasks; those submitted are done first, unless they are to be cancelled and have not begun."""
        with self._changed:
            self._closed = True
            while cancel_futures and self._todo:
                self._todo.popleft().future.cancel()
            self._changed.notify_all()
        if wait:
            for thread in self._threads:
                thread.join()

    def terminate_workers(self) -> None:
        """Stop at once: what has not begun is cancelled, what runs cleans up and ends with WorkerDied."""
        with self._changed:
            self._stopped = True
            running = list(self._running)
        for process in running:
            process.terminate()
        late = threading.Timer(LAST_WORDS_S, _kill, (running,))
        late.start()
        try:
            self.shutdown(cancel_futures=True)
        finally:
            late.cancel()

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if value is None:
            self.shutdown()
        else:
            self.terminate_workers()

    def _serve(self) -> None:
        """One worker's thread: give it tasks, hear what it says, replace it when it dies."""
        # Python handles signals in its main thread; a process inherits what the thread that starts it has blocked.
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        process: LocalProcess | None = None
        while (task := self._next()) is not None:
            if task.future.set_running_or_notify_cancel():
                process = self._do(task, process)
            del task  # what it holds is not needed while waiting for the next one
        self._forget(process)

    def _do(self, task: _Task, process: LocalProcess | None) -> LocalProcess | None:
        """Have a task done by the process, or by a fresh one. Returns the one for the next task, if there is one."""
        try:
            packed = bytes(ForkingPickler.dumps((task.call, task.args, task.kwargs)))
            if process is None or not process.is_alive():
                self._forget(process)
                process = self._start()
            kind, value = process.answer(packed, self._listener)
        except WorkerDied as error:
            self._forget(process)
            process = None
            task.future.set_exception(error)
        except BaseException as error:  # a task or an answer that no pickle holds, or the listener's: no answer is owed
            if process is not None:
                process.kill()
            self._forget(process)
            process = None
            task.future.set_exception(error)
        else:
            (task.future.set_exception if kind == RAISED else task.future.set_result)(value)
        return process

    def _next(self) -> _Task | None:
        """The first of the queue, once there is one; None when there will be no more."""
        with self._changed:
            self._idle += 1
            while not self._todo and not self._closed:
                self._changed.wait()
            self._idle -= 1
            return self._todo.popleft() if self._todo else None

    def _start(self) -> LocalProcess:
        with self._changed:
            if self._stopped:
                raise WorkerDied(-signal.SIGTERM)
            process = LocalProcess(self._initializer)
            self._running.add(process)
        return process

    def _forget(self, process: LocalProcess | None) -> None:
        if process is not None:
            with self._changed:
                self._running.discard(process)
            process.end()


def _kill(processes: Sequence[LocalProcess]) -> None:
    for process in processes:
        process.kill()
