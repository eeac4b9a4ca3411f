"""Late stamps are sorted in, those of a clock that was set back left out, and those of another clock moved or named."""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.config.schema import Topics
from quadlog.messages import Batch
from quadlog.recordings.clocks.clock import repeated_rows
from quadlog.recordings.clocks.clock_offsets import LATE_NS
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.recording import Recording
from quadlog.recordings.topics.roles import detect_roles

MS = 10**6
S = 1000 * MS
T0 = 1_700_000_000 * S


def stamps(*ms: int) -> np.ndarray:
    return np.array(ms, dtype=np.int64) * MS


@pytest.mark.parametrize(
    ("t_ns", "left_out"),
    [
        (stamps(), []),
        (stamps(0, 0, 100, 100), []),
        (stamps(0, 1000, 300, 2000), []),  # overtaken by 700 ms
        (np.concatenate([np.arange(0, 100), np.arange(60, 160)]) * 100 * MS, list(range(100, 140))),
        (stamps(*range(0, 1000, 100), 9000, *range(1000, 3000, 100)), [10]),  # one that ran ahead
        (stamps(9000, *range(0, 3000, 100)), [0]),
        (stamps(*range(0, 3000, 100), 500, *range(3000, 5000, 100)), [30]),  # one that is late
        (stamps(0, 1000, 2000, 3000, 1500, 4000, 5000), [4]),
        (stamps(*range(0, 1000, 100), 9000, 9100, 9200, 9300, *range(1000, 3000, 100)), [10, 11, 12, 13]),
        (stamps(0, 3000, 2200, 2300, 2400, 2500, 2600, 1500, 3100), [7]),  # late ones, and then one too late
        (stamps(9000, *range(0, 3000, 100), *range(500, 4000, 100)), [0, *range(31, 56)]),  # one ahead, then set back
        (stamps(*range(1_000_000, 1_003_000, 100), *range(3000, 103_000, 100)), list(range(30))),  # wrong at first
        (stamps(*range(50_000, 53_000, 100), *range(3000, 103_000, 100)), list(range(30))),
        (stamps(*range(90_000, 93_000, 100), *range(53_000, 56_000, 100), *range(6000, 50_000, 100)), list(range(60))),
        (stamps(*range(0, 9000, 100), *range(900_000, 903_000, 100), *range(12_000, 30_000, 100)), [*range(90, 120)]),
        (stamps(*range(0, 9000, 100), *range(900_000, 903_000, 100), *range(8000, 60_000, 100)), [*range(81, 120)]),
        (stamps(*range(900_000, 930_000, 100), *range(0, 9000, 100)), [*range(300, 390)]),  # wrong at the end
        (stamps(*range(0, 20_000, 1000), *range(0, 20_000, 100)), [*range(20, 211)]),  # set back, and more often
        # Set back twice.
        (100 * stamps(*range(50), *range(30, 60), *range(10, 80)), [*range(50, 70), *range(80, 130)]),
    ],
)
def test_repeated_rows(t_ns, left_out):
    assert np.flatnonzero(repeated_rows(t_ns)).tolist() == left_out


@given(st.lists(st.integers(0, 400), max_size=40))
def test_kept_stamps_go_back_by_no_more_than_messages_may_overtake(tenths):
    t_ns = stamps(*(100 * each for each in tenths))
    kept = t_ns[~repeated_rows(t_ns)]
    assert bool(len(kept)) == bool(len(t_ns))
    assert (kept >= np.maximum.accumulate(kept) - LATE_NS).all()


UWB = Channel("/uwb", "gtec_msgs/msg/Ranging", "cdr", "", b"")
RANGES = b"\0\1\0\0" + np.array([1, 2, 3000, 0], "<i4").tobytes() + bytes(16)
POINTS = np.random.default_rng(0).normal(0, 3, (120, 3))
BASE, MAP, SONAR = ("odom", "base_link"), ("map", "odom"), ("base_link", "sonar")
SIM = -1.6e9
Stream = str | tuple[str, str]


class Clocks(NamedTuple):
    """Streams of 12 s (topics and transforms), and how far their stamps are ahead of log time, s, None without stamps.

    says: of each warning a part. then: how far their times are, where these are others. stamp: as the user chose.
    alone: a stream, and log time and stamp, s, of one message more.
    """

    ahead: dict[Stream, float | Callable[[float], float] | None]
    says: tuple[str, ...] = ()
    then: dict[Stream, float] = {}  # noqa: RUF012
    stamp: str = "auto"
    alone: tuple[Stream, float, float] | None = None


BEHIND = "header stamps of {} lie {} s behind {}; {}".format
AHEAD = "header stamps of {} lie {} s ahead of {}; {}".format
LOG, KEEP = "take log times with  --stamp log", "they are moved by so much; keep them with  --stamp header"
DELAY = f"if that is not transport delay, {LOG}"
UNSTAMPED = "the log times of /uwb, which has no stamps"
OUTSIDE = "{}: 1 stamp from outside of the log (latched, or wrong); log times are used for them"
CLOCKS = {
    "delays": Clocks({"/odom": -0.02, "/points": -0.15, "/uwb": None}),
    "one clock, set wrong": Clocks({"/odom": -37.0, "/points": -37.15}),
    "half a second": Clocks({"/odom": 0, "/points": -0.5}, (BEHIND("/points", "0.50", "those of /odom", DELAY),)),
    "half a second ahead": Clocks({"/odom": 0.5, "/uwb": None}, (AHEAD("/odom", "0.50", UNSTAMPED, DELAY),)),
    "cloud behind": Clocks(
        {"/odom": -0.02, "/points": -2.02}, (BEHIND("/points", "2.00", "those of /odom", KEEP),), {"/points": -0.02}
    ),
    "odometry ahead": Clocks(
        {"/odom": 60.0, "/points": 0}, (AHEAD("/odom", "60.00", "those of /points", KEEP),), {"/odom": 0}
    ),
    "stamps that are kept": Clocks(
        {"/odom": -37, "/uwb": None}, (BEHIND("/odom", "37.00", UNSTAMPED, LOG),), stamp="header"
    ),
    "log times": Clocks({"/odom": -2, "/uwb": None}, then={"/odom": 0}, stamp="log"),
    "together, with their delays": Clocks(
        {"/odom": -37.0, "/points": -37.1, "/uwb": None},
        (BEHIND("/odom, /points", "37.00", UNSTAMPED, KEEP),),
        {"/odom": 0, "/points": -0.1},
    ),
    "none near log time": Clocks(
        {"/odom": -37, "/points": -39}, (BEHIND("/points", "2.00", "those of /odom", KEEP),), {"/points": -37}
    ),
    "a drift": Clocks(
        {"/odom": 0, "/points": lambda t_s: -0.3 * t_s},
        (BEHIND("/points", "1.94", "those of /odom", "they drift or jump by 2.45 s; " + LOG),),
    ),
    "a jump": Clocks(
        {"/odom": 0, "/points": lambda t_s: -0.8 * (t_s > 8)},
        (AHEAD("/points", "0.00", "those of /odom", "they drift or jump by 0.80 s; " + LOG),),
    ),
    "simulated time, faster": Clocks({BASE: lambda t_s: SIM + t_s, "/points": lambda t_s: SIM + t_s - 0.1}),
    "a reference": Clocks({"/odom": 0, "/mocap": -3}, (BEHIND("/mocap", "3.00", "those of /odom", LOG),)),
    "tf": Clocks(
        {BASE: 2, "/points": 0}, (AHEAD("odom -> base_link of /tf", "2.00", "those of /points", KEEP),), {BASE: 0}
    ),
    "tf that is dated ahead": Clocks({BASE: 0, MAP: 1.0, "/points": -0.1}),
    "another tf": Clocks(
        {BASE: lambda t_s: SIM - 0.3 * t_s, SONAR: 0, "/points": lambda t_s: SIM - 0.3 * t_s},
        ("base_link -> sonar of /tf lie 1600000001.94 s ahead of those of /points; log times are used for them",),
        {SONAR: lambda t_s: SIM - 0.3 * t_s},
    ),
    "a latched pose": Clocks({"/odom": 0}, (OUTSIDE.format("/odom"),), alone=("/odom", 0.01, -24)),
    "latched alone": Clocks({BASE: 0, "/points": 0}, (OUTSIDE.format("/pose"),), alone=("/pose", 7, -24)),
    "a stray": Clocks({"/odom": -0.1, "/points": 0}, (OUTSIDE.format("/odom"),), alone=("/odom", 11.95, 36)),
}


@pytest.mark.parametrize("name", CLOCKS)
def test_clocks_of_streams_that_are_compared(log, name):
    case = CLOCKS[name]

    def add(stream, log_ns, stamp_ns):
        if isinstance(stream, tuple):
            log.add(
                "/tf", log_ns, log.ros.tf(log.ros.transform(stamp_ns, *stream, (log_ns % S * 1e-9, 0, 0), (0, 0, 0, 1)))
            )
        elif stream == "/uwb":
            log.container.add(UWB, log_ns, RANGES)
        else:
            message = log.ros.cloud(stamp_ns, POINTS) if stream == "/points" else log.ros.odometry(stamp_ns)
            log.add(stream, log_ns, message)

    for log_ns in range(T0, T0 + 12 * S, 100 * MS):
        for stream, ahead in case.ahead.items():
            ahead_s = ahead((log_ns - T0) * 1e-9) if callable(ahead) else ahead
            add(stream, log_ns, log_ns + round((ahead_s or 0) * 1e9))
    if case.alone:
        add(case.alone[0], T0 + round(case.alone[1] * 1e9), T0 + round(case.alone[2] * 1e9))
    recording = Recording(log.container, stamp=case.stamp)
    roles = detect_roles(recording, Topics())
    warnings = recording.warnings
    times: dict[Stream, list[int]] = {}
    for each in recording.batches(roles.played):
        if isinstance(each, Batch):
            frames = (each.frame_id, each.child_frame_id)
            times.setdefault(frames if each.topic == "/tf" else each.topic, []).extend(each.rows["t_ns"].tolist())
        else:
            times.setdefault(each.topic, []).append(each.t_ns)
    # One by one they have the same times.
    singly = Recording(log.container, stamp=case.stamp)
    detect_roles(singly, Topics())
    assert sorted(chain(*times.values())) == sorted(each.t_ns for each in singly.messages(roles.played))
    for stream, ahead in (case.ahead | case.then).items():
        expected_s = [(ahead(t_s) if callable(ahead) else ahead or 0) + t_s for t_s in np.arange(120) / 10]
        found_s = [(t_ns - T0) * 1e-9 for t_ns in times[stream]]
        if case.alone and case.alone[0] == stream:
            found_s.remove(min(found_s, key=lambda t_s: abs(t_s - case.alone[1])))
        assert found_s == pytest.approx(expected_s, abs=0.5 if stream == SONAR else 0.02, rel=0)
    assert all(text in "\n".join(recording.warnings) for text in case.says), recording.warnings
    assert len(recording.warnings) == len(case.says), recording.warnings
    if not case.alone:
        assert recording.warnings == warnings  # known before anything is read, as info needs it
