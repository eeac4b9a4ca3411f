"""What a process of `LocalPool` does: one task at a time from its pipe, until the pipe or its parent is gone."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from types import FrameType
from typing import Any, NoReturn

from quadlog.pipelines.engine.interrupts import AGAIN_S
from quadlog.pipelines.engine.telling import told_to
from quadlog.results.files import remove_unfinished

LEFT = 128 + signal.SIGTERM
"""The exit code of a worker that was told to end."""
TOLD, DONE, RAISED = "told", "done", "raised"
"""What a worker sends: something said within a task, a task's result, a task's error."""
CLEAN_UP_S = 30.0
"""How long an orphan may take until it notices, amid a task, that it is to end."""
UNWIND_S = 2.0
"""How long a worker that is to end may take to clean up."""

_leaving = threading.Event()


def serve_tasks(connection: Connection, initializer: Callable[..., object] | None, initargs: tuple[Any, ...]) -> None:
    """Answer each pickled (call, args, kwargs) with DONE or RAISED, and end the process when there are no more.

    initializer: is called before the first.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches every process; the one with the terminal decides
    signal.signal(signal.SIGTERM, _leave)
    sys.unraisablehook = _lost
    threading.Thread(target=_see_it_end, name="quadlog-leaving", daemon=True).start()
    threading.Thread(target=_leave_with_parent, name="quadlog-orphan", daemon=True).start()
    sending, begin = threading.Lock(), initializer

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
                if begin is not None:
                    begin(*initargs)
                    begin = None
                call, args, kwargs = ForkingPickler.loads(task)
                answer = _pack(DONE, call(*args, **kwargs))
            except Exception as error:
                answer = _raised(error)
            if _leaving.is_set():  # and yet the task has come to an end, or to an error that is none of its own
                sys.exit(LEFT)
            send(answer)
    # All tasks are done and closed what they opened; to take apart what they loaded would take longer than some tasks.
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)


def _pack(kind: str, value: object) -> bytes:
    return bytes(ForkingPickler.dumps((kind, value)))


def _raised(error: Exception) -> bytes:
    """The error with the traceback it has here; one that does not come out of a pickle again goes as its words."""
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
    """SIGTERM: unwind, so that temporary folders and unfinished files go; a second one does not disturb that."""
    signal.signal(number, signal.SIG_IGN)
    _leaving.set()
    # What this breaks off amid C code may come out as any error, and would be taken for a bug by whoever prints it.
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 2)
    os.close(silence)
    sys.exit(LEFT)


def _lost(lost: sys.UnraisableHookArgs) -> None:
    """What C code that calls Python cannot pass on, as LLVM's, is printed; to leave is raised again a little later."""
    sys.__unraisablehook__(lost)
    ours = lost.exc_type is SystemExit and threading.current_thread() is threading.main_thread()
    if ours and _leaving.is_set():
        signal.signal(signal.SIGALRM, _leave)
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)


def _see_it_end() -> None:
    """Whatever may catch or lose the exception that `_leave` raises."""
    _leaving.wait()
    threading.Event().wait(UNWIND_S)
    remove_unfinished()
    os._exit(LEFT)


def _leave_with_parent() -> None:
    """Nobody waits for the result of an orphan."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os.kill(os.getpid(), signal.SIGTERM)
    threading.Event().wait(CLEAN_UP_S)
    os._exit(LEFT)
