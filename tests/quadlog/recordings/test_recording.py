from __future__ import annotations

import numpy as np
import pytest

from quadlog.errors import ClocksDiffer, UnknownTopic
from quadlog.recordings.containers.container import Channel
from quadlog.recordings.recording import Recording

S = 10**9
DAY = 86_400 * S
T0 = 1_700_000_000 * S
STILL = (0.0, 0.0, 0.0, 1.0)
RANGING = Channel("/gtec", "gtec_msgs/msg/Ranging", "cdr", "", b"")
RANGING_PAYLOAD = b"\0\1\0\0" + np.array([1, 2, 3000, 0], "<i4").tobytes() + bytes(16)


def times(recording, *arguments):
    return [each.t_ns for each in recording.messages(*arguments)]


def add_odometry(log, rows):
    """rows: log times and stamps after T0."""
    for i, (log_ns, stamp_ns) in enumerate(rows):
        log.add("/odom", T0 + log_ns, log.ros.odometry(T0 + stamp_ns, (i, 0, 0)))


@pytest.mark.parametrize("topics", ["/odm", "odom", ["/odom", "/odm"], {"/odm": 1}, iter(["/odm"])])
def test_a_topic_that_is_not_there_is_refused_at_once(log, topics):
    add_odometry(log, [(0, 0)])
    log.container.add(RANGING, T0 + 1, RANGING_PAYLOAD)
    with pytest.raises(UnknownTopic) as raised:
        Recording(log.container).messages(topics)
    assert str(raised.value).endswith("topics of the recording: /gtec, /odom")


@pytest.mark.parametrize(
    "rows",
    [
        [("/odom", 0, 47 * S - T0), ("/gtec", 1, None)],
        [("/odom", 0, -2 * DAY), ("/truth", 0, 0)],
        [("/odom", i, i + (i % 2) * DAY) for i in range(20)],
        [("/odom", i, i if i % 2 else (i + 1) * DAY - T0) for i in range(300)],
        [("/odom", i * S, i * S + (2 * DAY if i >= 5 else 0)) for i in range(30)],  # it jumps later on
    ],
)
def test_distant_clocks_are_never_mixed(log, rows):
    """rows: topic, log time and stamp after T0."""
    for topic, log_ns, stamp_ns in rows:
        if stamp_ns is None:
            log.container.add(RANGING, T0 + log_ns, RANGING_PAYLOAD)
        else:
            log.add(topic, T0 + log_ns, log.ros.odometry(T0 + stamp_ns))
    topics = sorted({topic for topic, _, _ in rows})
    with pytest.raises(ClocksDiffer, match=r"/odom.*--stamp log|/odom"):
        list(Recording(log.container).messages(topics))
    assert times(Recording(log.container, stamp="log"), topics) == [T0 + log_ns for _, log_ns, _ in rows]
    if len(topics) > 1:  # one topic needs no list; a second one in a second reading is mixed, too
        recording = Recording(log.container)
        assert len(times(recording, topics[0])) == 1
        with pytest.raises(ClocksDiffer):
            times(recording, topics[1])


@pytest.mark.parametrize("index", [0, 1, 50, 99])
@pytest.mark.parametrize("stamp", [1, 10**18])
def test_a_single_stray_stamp_costs_itself_wherever_it_stands(log, index, stamp):
    add_odometry(log, [(i * S, stamp - T0 if i == index else i * S) for i in range(100)])
    recording = Recording(log.container)
    for _ in range(6):  # reading it again makes it no clock
        assert times(recording, ["/odom"]) == [T0 + i * S for i in range(100) if i != index]
    assert len(recording.warnings) == 1


def test_each_transform_of_a_message_is_on_the_clock_and_static_ones_are_of_any_age(log):
    for i in range(20):
        ends = ((T0 + i, "base"), (5 if i == 10 else T0 + i, "person"))
        pair = [log.ros.transform(t_ns, "map", child, (i, 0.0, 0.0), STILL) for t_ns, child in ends]
        log.add("/tf", T0 + i, log.ros.tf(*pair))
    for stamp in (0, T0 - 9 * DAY):
        log.add("/tf_static", T0, log.ros.tf(log.ros.transform(stamp, "base", "imu", (0.0, 0.0, 0.1), STILL)))
    sizes = [len(each.message.transforms) for each in Recording(log.container).messages(["/tf"])]
    assert sizes == [1 if i == 10 else 2 for i in range(20)]
    static = [*Recording(log.container, stamp="log").messages(["/tf_static"])]
    assert [(each.t_ns, each.message.stamp_ns) for each in static] == [(T0, 0), (T0, T0 - 9 * DAY)]


def test_topics_that_cannot_be_decoded_are_a_loss_unless_they_are_of_no_use(log):
    """Of two types, or of an unknown encoding; a String is of no use."""
    add_odometry(log, [(0, 0)])
    log.add("/odom", T0 + 1, log.ros.range(T0, 1.0))
    log.add("/other", T0 + 2, log.ros.odometry(T0))
    for topic, name, encoding in (
        ("/points", "sensor_msgs/msg/PointCloud2", "cbor"),
        ("/chatter", "std_msgs/msg/String", "cdr"),
    ):
        log.container.add(Channel(topic, name, encoding, "", b""), T0, b"...")
    recording = Recording(log.container)
    assert [each.topic for each in recording.messages(["/odom", "/other", "/points", "/chatter"])] == ["/other"]
    assert {loss.topic for loss in recording.losses} == {"/odom", "/points"}
