"""A window finds what a look at every message finds, and asks an index for little more."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.recordings.clock import MARGIN_NS, EdgeMessage, log_begin, log_end
from quadlog.recordings.containers.container import Channel, RawMessage

S = 1_000_000_000
T0 = 1_700_000_000 * S
LENGTH_S = 60


class Logged:
    """A container whose messages are their stamps, by topic; it keeps what it was asked for."""

    span_ns = (T0, T0 + LENGTH_S * S)

    def __init__(self, topics: dict[str, list[tuple[int, int]]]) -> None:
        channels = {name: Channel(name, "", "", "", b"") for name in topics}
        rows = [(log_ns, name, t_ns) for name, rows in topics.items() for log_ns, t_ns in rows]
        self.raws = [RawMessage(channels[name], log_ns, b"%d" % t_ns) for log_ns, name, t_ns in sorted(rows)]
        self.asked: list[tuple[tuple[str, ...], int, int]] = []

    def messages(self, topics, start_ns, end_ns):
        self.asked.append((tuple(topics), start_ns, end_ns))
        return (raw for raw in self.raws if raw.channel.topic in topics and start_ns <= raw.log_time_ns < end_ns)

    def window(self, topics, start_ns, end_ns, lag_ns=0):
        look = lambda raws: (EdgeMessage(raw.channel.topic, raw.log_time_ns, int(raw.payload)) for raw in raws)  # noqa: E731
        return log_begin(self, topics, start_ns, lag_ns, look), log_end(self, topics, end_ns, lag_ns, look)

    def stamped(self, topics, start_ns, end_ns):
        return {
            (raw.channel.topic, raw.log_time_ns)
            for raw in self.raws
            if raw.channel.topic in topics and start_ns <= int(raw.payload) < end_ns
        }


@st.composite
def topic(draw: st.DrawFn) -> list[tuple[int, int]]:
    """(log time, stamp) of a topic in turn: a clock that drifts, jitter, and a stall that logs many at once."""
    hz = draw(st.sampled_from([0.2, 1.0, 10.0]))
    lag_s, drift, jitter_s = draw(st.floats(-2, 2)), draw(st.floats(-0.1, 0.1)), draw(st.floats(0, 0.05))
    stall_s, stall_length_s = draw(st.floats(0, LENGTH_S)), draw(st.sampled_from([0.0, 0.0, 3.0, 7.0]))
    begin_s, end_s = draw(st.sampled_from([(0.0, LENGTH_S), (20.0, 40.0)]))
    rows = []
    for index in range(int((end_s - begin_s) * hz)):
        at_s = begin_s + index / hz
        t_s = at_s - lag_s - drift * at_s
        at_s += jitter_s * (index % 3)
        if stall_s <= at_s < stall_s + stall_length_s:
            at_s = stall_s + stall_length_s + index * 1e-6
        rows.append((T0 + round(at_s * 1e9), T0 + round(t_s * 1e9)))
    rows.sort()
    times = sorted(t_ns for _, t_ns in rows)
    return [(log_ns, t_ns) for (log_ns, _), t_ns in zip(rows, times, strict=True)]


@given(st.lists(topic(), min_size=1, max_size=3), st.floats(-5, 65), st.floats(0.5, 40))
def test_a_window_has_all_that_is_stamped_within_it(
    topics: list[list[tuple[int, int]]], start_s: float, duration_s: float
) -> None:
    logged = Logged({f"/{number}": rows for number, rows in enumerate(topics)})
    names = [f"/{number}" for number in range(len(topics))]
    start_ns = T0 + round(start_s * 1e9)
    end_ns = start_ns + round(duration_s * 1e9)
    begin_ns, until_ns = logged.window(names, start_ns, end_ns)
    wanted = logged.stamped(names, start_ns, end_ns)
    assert all(begin_ns <= log_ns < until_ns for _, log_ns in wanted)


def steady(hz: float, lag_s: float = 0.0, from_s: float = 0.0, to_s: float = LENGTH_S) -> list[tuple[int, int]]:
    count = int((to_s - from_s) * hz)
    log_ns = [T0 + round((from_s + index / hz) * 1e9) for index in range(count)]
    return [(each, each - round(lag_s * 1e9)) for each in log_ns]


@pytest.mark.parametrize("silent", [(), (0.0, 10.0), (0.0, 19.9), (26.5, 60.0)])
def test_a_topic_that_is_silent_at_an_edge_is_looked_for_alone(silent: tuple[float, ...]) -> None:
    """Chunks without it stay untouched, so a window does not grow for it."""
    logged = Logged({"/odom": steady(50), "/target": steady(1, 0, *silent)[::40] if silent else []})
    begin_ns, until_ns = logged.window(["/odom", "/target"], T0 + 20 * S, T0 + 26 * S)
    assert (begin_ns, until_ns) == (T0 + 20 * S - MARGIN_NS, T0 + 26 * S + MARGIN_NS)
    assert all(topics == ("/target",) for topics, start, end in logged.asked if end - start > S)


def test_the_last_late_message_is_in_the_window() -> None:
    """A seldom topic that is 4 s late, which the look at the edge does not see."""
    logged, end_ns = Logged({"/odom": steady(50), "/late": steady(0.2, lag_s=4.0)}), T0 + 26_500_000_000
    _, until_ns = logged.window(["/odom", "/late"], T0, end_ns)
    assert max(log_ns for _, log_ns in logged.stamped(["/late"], T0, end_ns)) == T0 + 30 * S == until_ns - 1
