"""A window finds what a look at every message finds, and asks an index for little more."""

from __future__ import annotations

import struct
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.recordings.containers.container import Budget
from quadlog.recordings.recording import MARGIN_NS, Recording
from tests.quadlog.conftest import FakeContainer

S = 1_000_000_000
T0 = 1_700_000_000 * S
LENGTH_S = 60
Rows = list[tuple[int, int]]


class Logged(FakeContainer):
    """Ranges whose log times and stamps are given, by topic. part: what an excerpt has, None: it is small."""

    part: Logged | None = None

    def __init__(self, ros: SimpleNamespace, topics: dict[str, Rows]) -> None:
        super().__init__()
        self.topics = topics
        channel, payload = ros.channel("", "sensor_msgs/msg/Range"), ros.serialise(ros.range(0, 1.0))
        for name, rows in topics.items():
            for log_ns, t_ns in rows:
                own = type(channel)(name, *channel.identity[1:])
                self.add(own, log_ns, payload[:4] + struct.pack("<iI", *divmod(t_ns, S)) + payload[12:])

    def excerpt(self, budget: Budget) -> Logged | None:  # type: ignore[override]
        return self.part

    def window(self, start_ns: int, end_ns: int) -> list[tuple[str, int]]:
        """What a recording finds, sorted; the last pair of log times that was asked for is that of the window."""
        recording = Recording(self)  # type: ignore[arg-type]
        return sorted((each.topic, each.t_ns) for each in recording.messages(list(self.topics), start_ns, end_ns))

    def stamped(self, start_ns: int, end_ns: int) -> list[tuple[str, int]]:
        return sorted(
            (name, t_ns) for name, rows in self.topics.items() for _, t_ns in rows if start_ns <= t_ns < end_ns
        )


@st.composite
def topic(draw: st.DrawFn) -> Rows:
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
def test_a_window_has_all_that_is_stamped_within_it(both_ros, topics, start_s, duration_s):
    logged = Logged(both_ros.cdr, {f"/{number}": rows for number, rows in enumerate(topics)})
    start_ns = T0 + round(start_s * 1e9)
    end_ns = start_ns + round(duration_s * 1e9)
    assert logged.window(start_ns, end_ns) == logged.stamped(start_ns, end_ns)


def steady(hz: float, lag_s: float = 0.0, from_s: float = 0.0, to_s: float = LENGTH_S) -> Rows:
    count = int((to_s - from_s) * hz)
    log_ns = [T0 + round((from_s + index / hz) * 1e9) for index in range(count)]
    return [(each, each - round(lag_s * 1e9)) for each in log_ns]


@pytest.mark.parametrize(
    ("seldom", "lag_s"), [([], 0), (steady(0.2), 0), (steady(0.2, 4.0), 0), (steady(1, 0, 20, 30), 0), ([], 100)]
)
def test_the_index_is_asked_for_little_more(both_ros: SimpleNamespace, seldom: Rows, lag_s: int) -> None:
    """Also with a topic that is silent at the edges, or 4 s late, and where all stamps lag."""
    logged = Logged(both_ros.cdr, {"/odom": steady(5, lag_s)} | ({"/seldom": seldom} if seldom else {}))
    start_ns, stop_ns = T0 + (25 - lag_s) * S, T0 + (31 - lag_s) * S
    assert logged.window(start_ns, stop_ns) == logged.stamped(start_ns, stop_ns)
    begin_ns, end_ns = logged.asked[-1]
    assert begin_ns >= T0 + 25 * S - MARGIN_NS
    assert end_ns <= T0 + 35 * S + MARGIN_NS


@pytest.mark.parametrize("rate", [0.05, 0.5, 3.0, 5.0])
@pytest.mark.parametrize("begin", [0.0, 0.1, 0.5, 0.9])
def test_stamps_of_simulated_time_run_at_a_rate_of_their_own(both_ros, rate, begin):
    """Ten minutes of the log, of which a tenth is wanted and a look shows a sixtieth; one topic is 0.2 s late."""
    log_ns = [T0 + index * S for index in range(600)]
    stamps = {"/odom": 0, "/late": S // 5}
    topics = {name: [(each, T0 + round(rate * (each - T0)) - late) for each in log_ns] for name, late in stamps.items()}
    logged = Logged(both_ros.cdr, topics)
    logged.part = Logged(both_ros.cdr, {name: rows[::60] for name, rows in topics.items()})
    start_ns = T0 + round(rate * begin * 600 * S)
    end_ns = start_ns + round(rate * 60 * S)
    assert logged.window(start_ns, end_ns) == logged.stamped(start_ns, end_ns)
