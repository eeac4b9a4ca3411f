from __future__ import annotations

import errno
import signal
import sys
from types import SimpleNamespace

import pyarrow as pa
import pytest

from quadlog.errors import NotARun
from quadlog.pipelines.executor import machine as interrupts
from quadlog.pipelines.executor.machine import is_out_of_memory


@pytest.mark.parametrize(
    ("files", "most"),
    [
        ({"cpu.max": "150000 100000\n"}, 2),
        ({"cpu.max": "max 100000\n"}, 64),
        ({"cpu/cpu.cfs_quota_us": "50000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 1),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, 64),
        ({}, 64),
    ],
)
def test_a_containers_quota_limits_the_cores(files, most, tmp_path, monkeypatch):
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(content)
    monkeypatch.setattr(interrupts, "CGROUP", tmp_path)
    monkeypatch.setattr(interrupts.os, "sched_getaffinity", lambda _: range(64), raising=False)
    assert interrupts.cores() == most


@pytest.fixture
def clock(monkeypatch):
    """The time, to be set, of a process that has not been interrupted."""
    now = [0.0]
    monkeypatch.setattr(interrupts, "_taken_s", float("-inf"))
    monkeypatch.setattr(interrupts.time, "monotonic", lambda: now[0])
    return now


def test_interrupts_are_one_until_workers_have_gone(clock):
    for clock[0] in (100.0, 100.0 + interrupts.LAST_WORDS_S):
        assert [raises_at(clock, now_s) for now_s in (clock[0], clock[0], clock[0] + 0.04)] == [True, False, False]


def raises_at(clock, now_s):
    """Whether an interrupt then is one."""
    clock[0] = now_s
    try:
        interrupts._interrupt(signal.SIGINT, None)
    except KeyboardInterrupt:
        return True
    return False


@pytest.mark.parametrize("mine", [signal.SIG_IGN, lambda number, frame: None])
def test_who_has_an_ear_of_his_own_for_interrupts_keeps_it(mine):
    before = signal.signal(signal.SIGINT, mine)
    try:
        interrupts.take_one_interrupt()
        assert signal.getsignal(signal.SIGINT) is mine
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize(("lost_by", "is_told"), [(None, False), (print, True)])
def test_pythons_report_of_a_signal_amid_a_change_of_its_handler_is_not_passed_on(
    lost_by, is_told, capsys, monkeypatch
):
    """Python gives it to the hook for errors that nobody can catch, as one of no object: too rare to be provoked."""
    told = []
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    monkeypatch.setattr(sys, "__unraisablehook__", told.append)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        interrupts.take_one_interrupt()
        error = OSError("Signal 2 ignored due to race condition")
        sys.unraisablehook(SimpleNamespace(exc_type=OSError, exc_value=error, exc_traceback=None, object=lost_by))
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert bool(told) == is_told


def below(cause, error):
    """The error as it is raised from a cause."""
    error.__cause__ = cause
    return error


def after(other, error):
    """The error as it is raised while another one is handled."""
    error.__context__ = other
    return error


MAP = "libzstd.so.1: failed to map segment from shared object"


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
        pa.ArrowMemoryError("realloc of size 128 failed"),
        RuntimeError("can't start new thread"),
        ImportError(MAP),
        OSError(MAP),
        OSError("liba.so: cannot allocate memory"),
        RuntimeError("std::bad_alloc"),
        below(pa.ArrowMemoryError("realloc of size 128 failed"), NotARun("poses.parquet", "is damaged")),
        after(OSError(MAP), OSError("Could not find/load shared object file 'libllvmlite.so'")),
        below(None, after(below(MemoryError(), ValueError()), ImportError("numba needs llvmlite"))),
    ],
    ids=repr,
)
def test_lack_of_memory_is_recognised_in_whatever_form(error):
    assert is_out_of_memory(error)


@pytest.mark.parametrize(
    "error",
    [
        None,
        OSError(errno.ENOSPC, "No space left on device"),
        ImportError("No module named 'quadlog'"),
        ImportError(f"{MAP}: Operation not permitted"),
        ImportError("libgomp.so.1: cannot allocate memory in static TLS block"),
        NotARun("poses.parquet", "is damaged or no table"),
        ZeroDivisionError("cannot allocate memory"),
    ],
    ids=repr,
)
def test_what_only_sounds_like_it_is_not(error):
    assert not is_out_of_memory(error)


def test_a_ring_of_errors_has_an_end():
    one = ValueError()
    one.__context__ = below(one, KeyError())
    assert not is_out_of_memory(one)
