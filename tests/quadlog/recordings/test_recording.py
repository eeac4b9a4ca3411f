from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadlog.errors import ClocksDiffer, UnknownTopic
from quadlog.messages import Odometry, UwbRanges
from quadlog.recordings.clock import MARGIN_NS
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.recording import Recording, open_recording

S = 10**9
DAY = 86_400 * S
T0 = 1_700_000_000 * S
RANGING = Channel("/gtec", "gtec_msgs/msg/Ranging", "cdr", "", b"")
RANGING_PAYLOAD = b"\0\1\0\0" + np.array([1, 2, 3000, 0], "<i4").tobytes() + bytes(16)


def times(recording: Recording, *arguments: Any) -> list[int]:
    return [each.t_ns for each in recording.messages(*arguments)]


def test_header_or_log_clock(log: Any) -> None:
    for i in range(3):
        log.add("/odom", T0 + i * S, log.ros.odometry(T0 + i * S - 5, float(i)))
    assert times(Recording(log.container), ["/odom"]) == [T0 + i * S - 5 for i in range(3)]
    assert times(Recording(log.container, stamp="log"), ["/odom"]) == [T0 + i * S for i in range(3)]


@pytest.mark.parametrize("topics", ["/odm", "odom", ["/odom", "/odm"], {"/odm": 1}, iter(["/odm"])])
def test_a_topic_that_is_not_there_is_refused_at_once(log: Any, topics: Any) -> None:
    log.add("/odom", T0, log.ros.odometry(T0, 0.0))
    log.container.add(RANGING, T0 + 1, RANGING_PAYLOAD)
    recording = Recording(log.container)
    with pytest.raises(
        UnknownTopic, match=r"^/?od.*m is not in the recording; topics of the recording: /gtec, /odom$"
    ) as told:
        recording.messages(topics)
    assert (told.value.role, told.value.choices) == (None, ["/gtec", "/odom"])


def test_zero_stamps_fall_back_to_log_time_with_a_warning(log: Any) -> None:
    log.add("/odom", T0, log.ros.odometry(0, 0.0))
    recording = Recording(log.container)
    assert times(recording, ["/odom"]) == [T0]
    assert recording.warnings == ["/odom: 1 messages have the stamp 0; their log time is used"]


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([("/odom", 0, 47 * S - T0), ("/gtec", 1, None)], r"/odom .* --stamp log"),
        (
            [("/odom", 0, -2 * DAY), ("/truth", 0, 0)],
            r"/odom and header stamps of /truth lie 172800 s apart.* --stamp log",
        ),
        (
            [("/odom", i, i + (i % 2) * DAY) for i in range(20)],
            "header stamps of /odom and others of the same topic lie 86400 s apart",
        ),
        ([("/odom", i, i if i % 2 else (i + 1) * DAY - T0) for i in range(300)], "/odom"),
    ],
)
def test_distant_clocks_are_never_mixed(log: Any, rows: list[tuple[str, int, int | None]], said: str) -> None:
    """rows: topic, log time and stamp after T0."""
    for topic, log_ns, stamp_ns in rows:
        if stamp_ns is None:
            log.container.add(RANGING, T0 + log_ns, RANGING_PAYLOAD)
        else:
            log.add(topic, T0 + log_ns, log.ros.odometry(T0 + stamp_ns, 0.0))
    topics = sorted({topic for topic, _, _ in rows})
    with pytest.raises(ClocksDiffer, match=said):
        list(Recording(log.container).messages(topics))
    assert times(Recording(log.container, stamp="log"), topics) == [T0 + log_ns for _, log_ns, _ in rows]
    for topic in topics if len(topics) > 1 else ():
        assert len(times(Recording(log.container), topic)) == 1  # one topic needs no list


def test_distant_clocks_are_not_mixed_across_two_readings(log: Any) -> None:
    log.add("/odom", T0, log.ros.odometry(47 * S, 0.0))
    log.container.add(RANGING, T0 + 1, RANGING_PAYLOAD)
    recording = Recording(log.container)
    assert len(list(recording.messages(["/gtec"]))) == 1
    with pytest.raises(ClocksDiffer):
        list(recording.messages(["/odom"]))


@pytest.mark.parametrize("others", ["/gtec", "/zero", None])
def test_a_clock_that_jumps_later_on_is_not_mixed(log: Any, others: str | None) -> None:
    """With topics on log time, and with the same topic's own earlier stamps."""
    for i in range(30):
        t_ns = T0 + i * S // 10
        log.add("/odom", t_ns, log.ros.odometry(t_ns + (2 * DAY if i >= 5 else 0), float(i)))
        log.container.add(RANGING, t_ns, RANGING_PAYLOAD)
        log.add("/zero", t_ns, log.ros.range(0, 1.0))
    with pytest.raises(ClocksDiffer, match=r"/odom .*172800 s apart.*--stamp log"):
        list(Recording(log.container).messages([*filter(None, [others]), "/odom"]))
    assert len(times(Recording(log.container, stamp="log"), ["/odom", "/gtec"])) == 60


@pytest.mark.parametrize("index", [0, 1, 50, 99])
@pytest.mark.parametrize("stamp", [1, 10**18])
def test_a_single_stray_stamp_costs_itself_wherever_it_stands(log: Any, index: int, stamp: int) -> None:
    for i in range(100):
        log.add("/odom", T0 + i * S, log.ros.odometry(stamp if i == index else T0 + i * S, float(i)))
    recording = Recording(log.container)
    for _ in range(6):  # reading it again makes it no clock
        assert times(recording, ["/odom"]) == [T0 + i * S for i in range(100) if i != index]
    assert recording.warnings == [
        "/odom: 1 header stamps lie more than an hour from its others; those messages are dropped"
    ]


def test_static_transforms_are_of_any_age(log: Any) -> None:
    still = (0.0, 0.0, 0.0, 1.0)
    log.add("/tf_static", T0, log.ros.tf(log.ros.transform(0, "base", "lidar", (0.0, 0.0, 0.4), still)))
    log.add("/tf_static", T0, log.ros.tf(log.ros.transform(T0 - 9 * DAY, "base", "imu", (0.0, 0.0, 0.1), still)))
    log.add("/odom", T0 + 1, log.ros.odometry(47 * S, 0.0))
    recording = Recording(log.container)
    assert len(list(recording.messages(["/tf_static", "/odom"]))) == 3
    assert recording.warnings == []


def test_each_transform_of_a_message_is_on_the_clock(log: Any) -> None:
    still = (0.0, 0.0, 0.0, 1.0)
    for i in range(20):
        stray = 5 if i == 10 else T0 + i
        pair = [
            log.ros.transform(T0 + i, "map", "base", (i, 0.0, 0.0), still),
            log.ros.transform(stray, "map", "person", (i, 0.0, 0.0), still),
        ]
        log.add("/tf", T0 + i, log.ros.tf(*pair))
    sizes = [len(each.message.transforms) for each in Recording(log.container).messages(["/tf"])]
    assert sizes == [1 if i == 10 else 2 for i in range(20)]


def test_a_broken_message_is_counted_and_the_rest_is_read(log: Any) -> None:
    for i in range(5):
        log.add("/odom", T0 + i, log.ros.odometry(T0 + i, float(i)))
    raw = log.container.raw
    raw[1] = type(raw[1])(raw[1].channel, raw[1].log_time_ns, raw[1].payload[:40])
    raw[3] = type(raw[3])(raw[3].channel, raw[3].log_time_ns, b"")
    recording = Recording(log.container)
    for _ in range(2):  # reading again does not count the same losses again
        read = [each.message for each in recording.messages(["/odom"])]
        assert [each.position_m[0] for each in read if isinstance(each, Odometry)] == [0, 2, 4]
        (loss,) = recording.losses
        assert (loss.cause, loss.topic, loss.count) == ("decode", "/odom", 2)
        assert "not a nav_msgs/msg/Odometry" in loss.detail


def test_a_topic_with_two_types_is_refused(log: Any) -> None:
    log.add("/odom", T0, log.ros.odometry(T0, 0.0))
    log.add("/odom", T0 + 1, log.ros.range(T0, 1.0))
    log.add("/other", T0 + 2, log.ros.odometry(T0, 0.0))
    recording = Recording(log.container)
    assert [each.topic for each in recording.messages(["/odom", "/other"])] == ["/other"]
    (loss,) = recording.losses
    assert loss.topic == "/odom"
    assert "nav_msgs/msg/Odometry, sensor_msgs/msg/Range" in loss.detail


def test_topics_of_no_use_yield_nothing_and_are_no_loss(log: Any) -> None:
    log.container.add(Channel("/chatter", "std_msgs/msg/String", "cdr", "ros2msg", b"string data"), T0, b"")
    log.add("/odom", T0, log.ros.odometry(T0, 0.0))
    recording = Recording(log.container)
    assert [each.topic for each in recording.messages(["/chatter", "/odom"])] == ["/odom"]
    assert recording.losses == []


def test_an_unknown_encoding_is_a_named_loss(log: Any) -> None:
    log.container.add(Channel("/points", "sensor_msgs/msg/PointCloud2", "cbor", "", b""), T0, b"...")
    recording = Recording(log.container)
    assert times(recording, ["/points"]) == []
    assert any("'cbor'" in loss.detail for loss in recording.losses)


def test_windows_are_in_the_chosen_clock_and_found_by_the_index(log: Any) -> None:
    """Header stamps lag by 100 s; only the part of the log that can hold the window is read."""
    for i in range(200):
        log.add("/odom", T0 + i * S, log.ros.odometry(T0 + (i - 100) * S, float(i)))
    recording = Recording(log.container)
    assert times(recording, ["/odom"], T0, T0 + 3 * S) == [T0, T0 + S, T0 + 2 * S]
    start_ns, end_ns = log.container.asked[-1]
    assert start_ns == T0 + 100 * S - MARGIN_NS
    assert end_ns == T0 + 103 * S + MARGIN_NS


def test_ends_of_single_ranges_come_from_the_topic(log: Any) -> None:
    for topic in ("/uwb/tof/n_3/n_7/distance", "/uwb/tof/n_7/n_5/distance", "/mapped", "/sonar"):
        log.add(topic, T0, log.ros.range(T0, 2.5))
    recording = Recording(log.container, range_topics={"/mapped": (1, 9)}, anchor_ids=[7])
    ends = {}
    for topic in ("/uwb/tof/n_3/n_7/distance", "/uwb/tof/n_7/n_5/distance", "/mapped", "/sonar"):
        (timed,) = recording.messages([topic])
        assert isinstance(timed.message, UwbRanges)
        ends[topic] = (timed.message.tag, timed.message.anchor.tolist())
    assert list(ends.values()) == [(3, [7]), (5, [7]), (1, [9]), (None, [-1])]


@pytest.mark.skipif("QUADLOG_DATASETS" not in os.environ, reason="QUADLOG_DATASETS is not set")
def test_a_real_linktrack_log() -> None:
    path = Path(os.environ["QUADLOG_DATASETS"]) / "uwb_lias" / "lias_fast.mcap"
    with open_recording(path) as recording:
        first = recording.sample("/nlink_linktrack_tagframe0", 3)
        assert all(isinstance(each, UwbRanges) and set(each.anchor.tolist()) <= set(range(8)) for each in first)
        count = sum(1 for _ in recording.messages(["/nlink_linktrack_tagframe0"]))
    assert count == 40443
    assert recording.losses == []
