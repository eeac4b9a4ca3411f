from __future__ import annotations

import signal

import pytest

from quadlog.pipelines.engine import interrupts


@pytest.fixture
def clock(monkeypatch):
    """The time, to be set, of a process that has not been interrupted."""
    now = [0.0]
    monkeypatch.setattr(interrupts, "_taken_s", float("-inf"))
    monkeypatch.setattr(interrupts.time, "monotonic", lambda: now[0])
    return now


def test_interrupts_are_one_until_workers_have_gone(clock):
    for clock[0] in (100.0, 100.0 + interrupts.LAST_WORDS_S):
        with pytest.raises(KeyboardInterrupt):
            interrupts._interrupt(signal.SIGINT, None)
        for _ in range(3):
            interrupts._interrupt(signal.SIGINT, None)
            clock[0] += 0.01


@pytest.mark.parametrize("mine", [signal.SIG_IGN, lambda number, frame: None])
def test_who_has_an_ear_of_his_own_for_interrupts_keeps_it(mine):
    before = signal.signal(signal.SIGINT, mine)
    try:
        interrupts.take_one_interrupt()
        assert signal.getsignal(signal.SIGINT) is mine
    finally:
        signal.signal(signal.SIGINT, before)
