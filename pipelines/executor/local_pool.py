"""A pool of processes on this machine, in which a process that dies fails only its own task."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, NoReturn, ParamSpec, TypeVar

from quadlog.errors import WorkerDied
from quadlog.pipelines.executor.machine import AGAIN_S, LAST_WORDS_S
from quadlog.pipelines.executor.progress import Listener, told_to
from quadlog.storage.atomic_write import remove_unfinished

LEFT = 128 + signal.SIGTERM
"""Exit code of a worker that ends on SIGTERM."""
TOLD, DONE, RAISED = "told", "done", "raised"
"""Kinds of messages from a worker: a message of a task, its result, its error."""
CLEAN_UP_S = 30.0
"""Time for an orphan to end its task after SIGTERM, before it exits at once."""
UNWIND_S = 2.0
"""Time for a worker to clean up after SIGTERM, before it exits at once."""

_leaving = threading.Event()


def serve_tasks(connection: Connection) -> None:
    """Run in a worker: answer each pickled (call, args, kwargs) with DONE or RAISED; exit when the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches every process; the parent handles it
    signal.signal(signal.SIGTERM, _leave)
    sys.unraisablehook = _lost
    threading.Thread(target=_see_it_end, name="quadlog-leaving", daemon=True).start()
    threading.Thread(target=_leave_with_parent, name="quadlog-orphan", daemon=True).start()
    sending = threading.Lock()

    def send(packed: bytes) -> None:
        with sending:
            connection.send_bytes(packed)

    with connection, told_to(lambda message: send(_pack(TOLD, message))):
        while True:
            try:
                task = connection.recv_bytes()
            except (EOFError, OSError):
                break
            try:
                call, args, kwargs = ForkingPickler.loads(task)
                answer = _pack(DONE, call(*args, **kwargs))
            except Exception as error:
                answer = _raised(error)
            if _leaving.is_set():  # the task ended in spite of SIGTERM, or with an error caused by it
                sys.exit(LEFT)
            send(answer)
    # All tasks have closed their files. A regular exit, which unloads modules, would take longer than some tasks.
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)


def _pack(kind: str, value: object) -> bytes:
    return bytes(ForkingPickler.dumps((kind, value)))


def _raised(error: Exception) -> bytes:
    """The error with this process's traceback as a note; one that cannot be pickled as a RuntimeError of its text."""
    told = f"in a worker process:\n{''.join(traceback.format_exception(error))}"
    error.add_note(told)
    try:
        answer = _pack(RAISED, error)
        ForkingPickler.loads(answer)
    except Exception:
        words = RuntimeError(f"{type(error).__name__}: {error}")
        words.add_note(told)
        answer = _pack(RAISED, words)
    return answer


def _leave(number: int, _: FrameType | None) -> NoReturn:
    """Handler of SIGTERM: exit with clean-up of temporary and unfinished files. Further SIGTERMs are ignored."""
    signal.signal(number, signal.SIG_IGN)
    _leaving.set()
    # SystemExit within C code may surface as any error, which must not be printed.
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 2)
    os.close(silence)
    sys.exit(LEFT)


def _lost(lost: sys.UnraisableHookArgs) -> None:
    """Hook for errors that C code, as LLVM's, cannot pass on: a lost SystemExit is raised again a little later."""
    sys.__unraisablehook__(lost)
    ours = lost.exc_type is SystemExit and threading.current_thread() is threading.main_thread()
    if ours and _leaving.is_set():
        signal.signal(signal.SIGALRM, _leave)
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)


def _see_it_end() -> None:
    """Exit after UNWIND_S, even if something caught the exception that `_leave` raises."""
    _leaving.wait()
    threading.Event().wait(UNWIND_S)
    remove_unfinished()
    os._exit(LEFT)


def _leave_with_parent() -> None:
    """End when the parent process ends."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)
    threading.Event().wait(CLEAN_UP_S)
    os._exit(LEFT)


THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
# One heap for all threads of a worker: with glibc's own for each, it grows by 5 % with every recording.
_ENVIRONMENT = dict.fromkeys((*THREAD_VARIABLES, "MALLOC_ARENA_MAX"), "1")

# Threads share the environment, and starting a process reaps others, which another thread may be waiting for.
_processes = threading.Lock()


@contextmanager
def _in_a_folder() -> Iterator[None]:
    """Another working folder for the block, where that of this process was deleted: a new process must have one."""
    try:
        Path.cwd()
    except FileNotFoundError:
        deleted = os.open(".", os.O_RDONLY)
        try:
            os.chdir("/")
            yield
        finally:
            os.fchdir(deleted)
            os.close(deleted)
    else:
        yield


class LocalProcess:
    """A spawned process that answers tasks."""

    def __init__(self) -> None:
        """Spawned, because a forked process would inherit locks of libraries' threads."""
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = multiprocessing.Pipe()
        self._process: SpawnProcess = context.Process(target=serve_tasks, args=(theirs,), daemon=True)
        with _processes, _environment(), _in_a_folder():
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
        """Close its pipe, wait until it ends, and return its exit code; -N if signal N killed it."""
        self._connection.close()
        wait([self._process.sentinel])
        with _processes:
            self._process.join()
        return self._process.exitcode or 0


@contextmanager
def _environment() -> Iterator[None]:
    """One thread for each library of a worker; libraries read these variables when they are loaded."""
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


P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class _Task:
    future: Future[Any]
    call: Callable[..., Any]
    args: tuple[Any, ...]
    kwargs: dict[str, Any]


class LocalPool(Executor):
    """An executor of spawned processes, each with one thread for BLAS and numba; tasks start in their order.

    A thread of this process serves each worker, which is started for its first task. When a worker dies, its task's
    future gets WorkerDied and a new process takes the next task. An exception in the body of a `with` stops all
    workers at once. The standard library's pool would fail every task when one process dies.
    """

    def __init__(self, workers: int, listener: Listener | None = None) -> None:
        """listener: called with each message of a task."""
        self._workers, self._listener = workers, listener
        self._todo: deque[_Task] = deque()
        self._changed = threading.Condition()
        self._threads: list[threading.Thread] = []
        self._running: set[LocalProcess] = set()
        self._idle = 0
        self._closed = self._stopped = False

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """The future of a queued call. Raises RuntimeError after `shutdown`."""
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
        """Take no more tasks; finish those submitted, or cancel those that have not begun."""
        with self._changed:
            self._closed = True
            while cancel_futures and self._todo:
                future = self._todo.popleft().future
                future.cancel()
                future.set_running_or_notify_cancel()  # `wait` and `as_completed` count only what was notified
            self._changed.notify_all()
        if wait:
            for thread in self._threads:
                thread.join()

    def terminate_workers(self) -> None:
        """Stop at once: queued tasks are cancelled, running ones clean up and fail with WorkerDied."""
        self.shutdown(wait=False, cancel_futures=True)  # first, or a worker that ends would take a queued task
        with self._changed:
            self._stopped = True
            running = list(self._running)
        for process in running:
            process.terminate()
        late = threading.Timer(LAST_WORDS_S, _kill, (running,))
        late.start()
        try:
            self.shutdown()
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
        """Thread of one worker: pass it tasks and messages back, and replace it when it dies."""
        # Python handles signals in its main thread; a process inherits what the thread that starts it has blocked.
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        process: LocalProcess | None = None
        while (task := self._next()) is not None:
            if task.future.set_running_or_notify_cancel():
                process = self._do(task, process)
            del task  # free its arguments while waiting for the next one
        self._forget(process)

    def _do(self, task: _Task, process: LocalProcess | None) -> LocalProcess | None:
        """Run a task in the process, or in a new one. Returns the process for the next task, None if it has ended."""
        try:
            packed = bytes(ForkingPickler.dumps((task.call, task.args, task.kwargs)))
            if process is None or not process.is_alive():
                self._forget(process)
                process = self._start()
            kind, value = process.answer(packed, self._listener)
        except BaseException as error:  # not picklable, raised by the listener, or WorkerDied
            if process is not None:
                process.kill()
            self._forget(process)
            task.future.set_exception(error)
            return None
        (task.future.set_exception if kind == RAISED else task.future.set_result)(value)
        return process

    def _next(self) -> _Task | None:
        """The next task, waiting for one; None after `shutdown` when the queue is empty."""
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
            process = LocalProcess()
            self._running.add(process)
        return process

    def _forget(self, process: LocalProcess | None) -> None:
        if process is not None:
            with self._changed:
                self._running.discard(process)
            process.end()


def _kill(processes: list[LocalProcess]) -> None:
    for process in processes:
        process.kill()
