from __future__ import annotations

import signal
import sys
from types import SimpleNamespace

import pytest

from quadlog.pipelines.executor import machine as interrupts


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
