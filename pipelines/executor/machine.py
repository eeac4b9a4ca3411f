"""Cores, signals, and errors that mean lack of memory."""

from __future__ import annotations

import errno
import os
import signal
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from types import FrameType

CGROUP = Path("/sys/fs/cgroup")
_QUOTAS = (("cpu.max",), ("cpu/cpu.cfs_quota_us", "cpu/cpu.cfs_period_us"))
"""Files with a container's CPU time and its period in µs, of cgroups version 2 and 1; no number without a limit."""


def cores() -> int:
    """How many cores this process may use: by its affinity and by its container's quota of CPU time."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for names in _QUOTAS:
        with suppress(OSError, ValueError):
            quota_us, period_us = (int(word) for name in names for word in (CGROUP / name).read_text().split())
            if quota_us > 0 and period_us > 0:
                count = min(count, -(-quota_us // period_us))
    return count


LAST_WORDS_S = 5.0
"""Time for a stopped worker to clean up before it is killed."""
AGAIN_S = 0.01
"""Delay before an interrupt that was lost in C code is raised again."""

_taken_s = float("-inf")


def take_one_interrupt() -> None:
    """Make SIGINT, SIGTERM and SIGHUP raise KeyboardInterrupt, with the signal's name unless it is SIGINT.

    Further signals are ignored for LAST_WORDS_S, since one during the clean-up would orphan the workers. An interrupt
    that C code cannot pass on is raised again. Signals that the process was started to ignore stay ignored.
    """
    for number, usual in ((signal.SIGINT, signal.default_int_handler), *((each, signal.SIG_DFL) for each in _OTHERS)):
        if signal.getsignal(number) is usual:
            signal.signal(number, _interrupt)
    sys.unraisablehook = _raise_lost_again


_OTHERS = (signal.SIGTERM, signal.SIGHUP)


def ignore_interrupts() -> None:
    """Ignore all signals, for a process that has printed its result and is about to exit."""
    for number in (signal.SIGINT, *_OTHERS):
        signal.signal(number, signal.SIG_IGN)


def _interrupt(number: int, _: FrameType | None) -> None:
    global _taken_s
    now_s = time.monotonic()
    if now_s - _taken_s >= LAST_WORDS_S:
        _taken_s = now_s
        _raise(number)


class _Stopped(KeyboardInterrupt):
    """Not a plain one: where that leaves `exec`, `python -m` ends by SIGINT whatever exit code is asked for."""


def _raise(number: int) -> None:
    raise _Stopped(*([] if number == signal.SIGINT else [signal.Signals(number).name]))


def _raise_lost_again(lost: sys.UnraisableHookArgs) -> None:
    """Hook for exceptions in destructors and callbacks from C, which Python otherwise prints and drops.

    Python reports one without an object for a signal that comes while its handler is replaced by SIG_IGN.
    """
    if lost.exc_type is OSError and lost.object is None:
        return
    if not issubclass(lost.exc_type, KeyboardInterrupt) or threading.current_thread() is not threading.main_thread():
        sys.__unraisablehook__(lost)
        return
    name = lost.exc_value.args[0] if lost.exc_value is not None and lost.exc_value.args else "SIGINT"
    signal.signal(signal.SIGALRM, lambda _number, _frame: _raise(signal.Signals[name]))
    signal.setitimer(signal.ITIMER_REAL, AGAIN_S)


_WORDS = (
    *("cannot allocate memory", "can't start new thread", "failed to map segment", "cannot map zero-fill pages"),
    *("cannot create shared object descriptor", "bad_alloc"),
)
"""Messages of the C library, its loader, Python's threads and C++; the exception class varies."""
_OTHER_CAUSES = ("static tls block", "operation not permitted", "permission denied")
"""Messages with these have another cause: static TLS space, or a disk mounted noexec."""


def is_out_of_memory(error: BaseException | None) -> bool:
    """Whether lack of memory is the error, its cause or its context."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
            return True
        words = str(error).lower() if isinstance(error, ImportError | OSError | RuntimeError) else ""
        if any(each in words for each in _WORDS) and not any(each in words for each in _OTHER_CAUSES):
            return True
        error = error.__cause__ or error.__context__
    return False
