from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import pytest

from quadlog.recordings.container import Channel
from quadlog.recordings.recording import Recording, open_recording
from quadlog.recordings.survey import survey

MS = 10**6
T0 = 1_700_000_000_000 * MS


def test_counts_rates_gaps_and_clock_offset(log: Any) -> None:
    """100 messages at 10 Hz, a pause of a second, 100 at 20 Hz; the header lags log time by 30 ms."""
    t_ns = T0
    for i in range(200):
        t_ns += 1000 * MS if i == 100 else (100 if i < 100 else 50) * MS
        log.add("/odom", t_ns, log.ros.odometry(t_ns - 30 * MS, 0.0))
    (topic,) = survey(Recording(log.container)).topics
    assert topic.messages == 200
    assert topic.hz_max == pytest.approx(20)
    assert topic.hz_min == pytest.approx(10 / 1.9)  # ten intervals: nine of 0.1 s and the pause
    assert topic.gaps == 1
    assert topic.longest_gap_s == pytest.approx(1.0)
    assert topic.clock_offset_s == pytest.approx(-0.03)


@pytest.mark.parametrize(("count", "hz"), [(0, None), (1, None), (2, 2.0), (5, 2.0)])
def test_few_messages(log: Any, count: int, hz: float | None) -> None:
    channel = Channel("/chatter", "std_msgs/msg/String", "cdr", "ros2msg", b"string data")
    log.container.known["/chatter", channel.type_name] = channel
    for i in range(count):
        log.container.add(channel, T0 + i * 500 * MS, b"")
    (topic,) = survey(Recording(log.container)).topics
    assert (topic.messages, topic.hz_min, topic.hz_max, topic.clock_offset_s) == (count, hz, hz, None)


def test_offset_of_types_that_quadlog_does_not_decode(log: Any) -> None:
    """Only the header at the payload's front is read, by the embedded definition or the standard one."""
    kind = log.ros.type("geometry_msgs/msg/PointStamped")
    message = kind(log.ros.header(T0 - 7 * MS), log.ros.type("geometry_msgs/msg/Point")(0.0, 0.0, 0.0))
    log.add("/embedded", T0, message)
    bare = Channel("/bare", "geometry_msgs/msg/PointStamped", "cdr", "", b"")
    log.container.add(bare, T0, log.ros.serialise(message))
    text = b"module m { module msg { struct Other { float a; }; @x struct A { std_msgs::msg::Header header; }; }; };"
    log.container.add(Channel("/idl", "m/msg/A", "cdr", "ros2idl", text), T0, log.ros.serialise(message)[:40])
    offsets = {each.name: each.clock_offset_s for each in survey(Recording(log.container)).topics}
    assert offsets == {name: pytest.approx(-0.007) for name in ("/embedded", "/bare", "/idl")}


def test_links_and_losses(log: Any) -> None:
    for i in range(4):
        log.add("/uwb/n_0/n_2", T0 + i, log.ros.range(T0 + i, 1.0 + i))
    raw = log.container.raw[0]
    log.container.raw[0] = type(raw)(raw.channel, raw.log_time_ns, b"")
    recording = Recording(log.container)
    seen = survey(recording)
    (link,) = seen.links["/uwb/n_0/n_2"]
    assert (link.tag, link.anchor, link.messages, link.range_min_m, link.range_max_m) == (0, 2, 3, 2.0, 4.0)
    assert [(loss.cause, loss.count) for loss in recording.losses] == [("decode", 1)]
    assert seen.messages == 4


def test_reach_of_links_without_a_number(log: Any) -> None:
    for i, range_m in enumerate([math.nan, 3.0, -1.0, -math.inf]):
        log.add("/uwb/n_0/n_2", T0 + i, log.ros.range(T0 + i, range_m))
        log.add("/uwb/n_0/n_3", T0 + i, log.ros.range(T0 + i, math.nan))
    links = survey(Recording(log.container)).links
    (some,), (none,) = links["/uwb/n_0/n_2"], links["/uwb/n_0/n_3"]
    assert (some.messages, some.range_min_m, some.range_max_m) == (4, -1.0, 3.0)
    assert (none.messages, none.range_min_m, none.range_max_m) == (4, None, None)


def test_how_far_stamps_of_ranges_go_back(log: Any) -> None:
    for i, ms in enumerate([0, 100, 200, 50, 150, 140]):
        log.add("/uwb/n_0/n_2", T0 + i, log.ros.range(T0 + ms * MS, 1.0))
        log.add("/uwb/n_0/n_3", T0 + i, log.ros.range(T0 + i * MS, 1.0))
    back, sound = survey(Recording(log.container)).topics
    assert (back.clock_back_ns, back.clock_back_to_ns) == (150 * MS, T0 + 50 * MS)
    assert (sound.clock_back_ns, sound.clock_back_to_ns) == (0, 0)


@pytest.mark.skipif("QUADLOG_DATASETS" not in os.environ, reason="QUADLOG_DATASETS is not set")
def test_a_real_bag() -> None:
    path = Path(os.environ["QUADLOG_DATASETS"]) / "odometry" / "jackal_odom_imu.bag"
    with open_recording(path) as recording:
        seen = survey(recording)
    assert {each.name: each.messages for each in seen.topics} == {
        "/imu/data": 3061,
        "/jackal_velocity_controller/odom": 3060,
    }
    assert all(each.hz_min is not None and 40 < each.hz_min < 60 for each in seen.topics)
