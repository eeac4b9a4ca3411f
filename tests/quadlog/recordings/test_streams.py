from __future__ import annotations

import numpy as np
import pytest

from quadlog.config.schema import Config
from quadlog.recordings.recording import Recording
from quadlog.recordings.streams import gather

S = 10**9
T0 = 1_700_000_000 * S
STILL = (0.0, 0.0, 0.0, 1.0)


def moved(log, t_ns, parent, child, x_m):
    return log.ros.transform(t_ns, parent, child, (float(x_m), 0.0, 0.0), STILL)


def test_series_of_each_role(log):
    """Of ranges also those of topics without ids, or without those of anchors, which are left out and counted."""
    for i in range(5):
        log.add("/odom", T0 + i * S, log.ros.odometry(T0 + i * S, (i, 0, 0), twist=(0.5, 0, 0, 0, 0, 0.25)))
        log.add("/uwb/n_0/n_2", T0 + i * S, log.ros.range(T0 + i * S + 5, 1.0 + i))
        log.add("/sonar", T0 + i * S, log.ros.range(T0 + i * S, 1.0))
        log.add("/half", T0 + i * S, log.ros.range(T0 + i * S, 1.0))
    half = {"topic": "/half", "field": "range", "tag": 0}
    recording = Recording(log.container, Config.model_validate({"uwb": {"range_topics": [half]}}))
    streams = gather(recording, odometry="/odom", uwb=["/uwb/n_0/n_2", "/sonar", "/half"])
    assert streams.odometry.t_ns.tolist() == [T0 + i * S for i in range(5)]
    assert streams.odometry.position_m[:, 0].tolist() == [0, 1, 2, 3, 4]
    assert (streams.odometry.frame_id, streams.odometry.child_frame_id) == ("odom", "base_link")
    assert streams.odometry_linear_mps.tolist() == [[0.5, 0, 0]] * 5
    assert streams.odometry_angular_radps[:, 2].tolist() == [0.25] * 5
    assert (streams.ranges.tag.tolist(), streams.ranges.anchor.tolist()) == ([0] * 5, [2] * 5)
    assert streams.ranges.range_m.tolist() == [1, 2, 3, 4, 5]
    assert (streams.reference, streams.imu) == (None, None)
    assert [each[:16] for each in streams.warnings] == ["/sonar: 5 ranges", "/half: 5 ranges "]


@pytest.mark.parametrize(
    ("stamps", "kept"),
    [
        ([1, 4, 3, 3, 3, 5], [0, 2, 1, 5]),
        ([1, 2, 60 * S, 4, 5], [0, 1, 3, 4]),
        ([1, 2, 4 * 10**17, 4, 5], [0, 1, 3, 4]),
    ],
)
def test_late_stamps_are_sorted_in_repeated_and_stray_ones_are_dropped(log, stamps, kept):
    for i, stamp in enumerate(stamps):
        log.add("/odom", T0 + i, log.ros.odometry(T0 + stamp, (i, 0, 0)))
        log.add("/uwb/n_0/n_2", T0 + i, log.ros.range(T0 + min(stamp, 9), float(i)))
    streams = gather(Recording(log.container), odometry="/odom", uwb=["/uwb/n_0/n_2"])
    assert streams.odometry.position_m[:, 0].tolist() == kept
    assert (np.diff(streams.ranges.t_ns) >= 0).all()
    assert len(streams.ranges) == len(stamps)


@pytest.mark.parametrize(("ahead_s", "until", "lost"), [(3, 120, range(120, 180)), (1000, 12, range(12))])
def test_a_clock_that_is_set_back_costs_all_topics_the_same_stretch(log, ahead_s, until, lost):
    """Ranges, odometry, a reference and tf at three rates, tf with a second transform on another clock, and one
    that begins after the clock was set. Of a clock that was wrong for a short time at first the rest is kept.
    """
    for i in range(200):
        t_ns = T0 + i * S // 20
        stamp = t_ns + (i < until) * ahead_s * S
        log.add("/truth", t_ns, log.ros.odometry(stamp, (i, 0, 0)))
        if i % 2 == 0:
            other = [moved(log, t_ns, "map", "odom", i)] if i % 4 else []
            log.add("/tf", t_ns, log.ros.tf(moved(log, stamp, "odom", "base_link", i), *other))
        if i % 5 == 0:
            log.add("/odom", t_ns, log.ros.odometry(stamp, (i, 0, 0)))
            log.add("/uwb/n_0/n_2", t_ns, log.ros.range(stamp, float(i)))
            log.add("/uwb/n_0/n_3", t_ns, log.ros.range(t_ns, float(i)))
            if i >= 150:
                log.add("/uwb/n_0/n_4", t_ns, log.ros.range(stamp, float(i)))
    topics = {"odometry": "/odom", "reference": "/truth", "uwb": [f"/uwb/n_0/n_{n}" for n in (2, 3, 4)], "tf": ["/tf"]}
    streams = gather(Recording(log.container), **topics)
    tf, ranges = streams.tf, streams.ranges
    for step, found in (
        (1, streams.reference.position_m[:, 0]),
        (5, streams.odometry.position_m[:, 0]),
        (5, ranges.range_m[ranges.anchor == 2]),
        (2, tf.pose_series("base_link", "odom").position_m[:, 0]),
    ):
        assert found.tolist() == [i for i in range(0, 200, step) if i not in lost]
    assert (ranges.anchor == 3).sum() == 40
    assert ranges.range_m[ranges.anchor == 4].tolist() == [i for i in range(150, 200, 5) if i not in lost]
    assert tf.pose_series("odom", "map").position_m[:, 0].tolist() == [*range(2, 200, 4)]
    counts = {each.topic: each.count for each in streams.losses}
    each, fifth, half = (len(lost[::step]) for step in (1, 5, 2))
    alone = {"/uwb/n_0/n_4": 6} if until == 120 else {}
    assert counts == {"/truth": each, "/odom": fifth, "/uwb/n_0/n_2": fifth, "/tf": half} | alone
    by_log = gather(Recording(log.container, stamp="log"), **topics)
    assert len(by_log.reference.t_ns) == 200
    assert by_log.losses == []


def test_transforms_of_several_publishers_that_come_late_are_no_loss(log):
    """Two publishers of one transform, of which one comes 400 ms late."""
    for i in range(100):
        for late_ns in (0, 400_000_000):
            stamp = T0 + i * S // 20 - late_ns + late_ns // 40
            log.add("/tf", T0 + i * S // 20, log.ros.tf(moved(log, stamp, "map", "base_link", i)))
    streams = gather(Recording(log.container), tf=["/tf"])
    assert len(streams.tf.pose_series("base_link", "map")) == 200
    assert (streams.warnings, streams.losses) == ([], [])


def test_static_transforms_count_from_before_the_window(log):
    log.add("/tf_static", T0, log.ros.tf(log.ros.transform(T0, "base_link", "lidar", (0.0, 0.0, 0.4), STILL)))
    for i in range(10):
        log.add("/tf", T0 + i * S, log.ros.tf(moved(log, T0 + i * S, "map", "base_link", i)))
    streams = gather(Recording(log.container), tf=["/tf", "/tf_static"], start_ns=T0 + 5 * S, end_ns=T0 + 8 * S)
    assert streams.tf.static_transform("lidar", "base_link")[2, 3] == pytest.approx(0.4)
    series = streams.tf.pose_series("lidar", "map")
    assert series.position_m[:, 0].tolist() == [5, 6, 7]
    np.testing.assert_allclose(series.position_m[:, 2], 0.4)
