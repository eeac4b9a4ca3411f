from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.recordings import survey
from quadlog.recordings.containers.bounded_reader import Damaged
from quadlog.recordings.containers.container import Channel, LogTimes
from quadlog.recordings.survey import Pulse, indexed_pulses

CHANNEL = Channel("/a", "std_msgs/msg/String", "cdr", "ros2msg", b"string data")


def told(pulse: Pulse) -> tuple[Any, ...]:
    return pulse.messages, pulse.first_ns, pulse.last_ns, pulse.longest_ns, pulse.rates_hz(), pulse.gaps()


@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=80), st.integers(1, 30))
def test_batches_make_no_difference_and_rates_are_those_of_all_runs(steps: list[int], size: int) -> None:
    t_ns = np.cumsum(np.array(steps, np.int64))
    batched, whole = Pulse(), Pulse()
    whole.take(t_ns)
    for begin in range(0, len(t_ns), size):
        batched.take(t_ns[begin : begin + size])
    assert told(batched) == told(whole)
    runs_ns = [b - a for a, b in zip(t_ns.tolist(), t_ns[10:].tolist(), strict=False) if b > a]
    if runs_ns:
        assert whole.rates_hz() == pytest.approx((1e10 / max(runs_ns), 1e10 / min(runs_ns)))


def test_chunks_that_overlap_are_put_in_order() -> None:
    """Far more times than are kept: of 80 chunks, each reaches into the next."""
    t_ns = np.cumsum(np.random.default_rng(1).integers(1, 10**6, 800_000))
    late = np.arange(len(t_ns)) // 10_000 + (np.arange(len(t_ns)) % 7 == 0)

    def log_times() -> Iterator[LogTimes]:
        for chunk in range(late.max() + 1):
            yield LogTimes(int(t_ns[late == chunk].min()), CHANNEL, t_ns[late == chunk])

    whole = Pulse()
    whole.take(t_ns)
    container: Any = SimpleNamespace(channels=(CHANNEL,), log_times=log_times)
    assert told(indexed_pulses(container)[CHANNEL]) == told(whole)


def test_chunks_that_all_overlap_are_refused_before_they_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(survey, "_MOST_TIMES", 1 << 20)
    batch = np.arange(1 << 18)
    endless: Any = SimpleNamespace(
        channels=(CHANNEL,), log_times=lambda: (LogTimes(0, CHANNEL, batch) for _ in range(40))
    )
    with pytest.raises(Damaged, match="overlap too much"):
        indexed_pulses(endless)
