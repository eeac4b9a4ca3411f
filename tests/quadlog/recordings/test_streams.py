from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from quadlog.recordings.containers.container import Loss
from quadlog.recordings.recording import Recording
from quadlog.recordings.streams import gather

S = 10**9
T0 = 1_700_000_000 * S


def test_series_of_each_role(log: Any) -> None:
    for i in range(5):
        log.add("/odom", T0 + i * S, log.ros.odometry(T0 + i * S, float(i)))
        log.add("/uwb/n_0/n_2", T0 + i * S, log.ros.range(T0 + i * S + 5, 1.0 + i))
    streams = gather(Recording(log.container), odometry="/odom", uwb=["/uwb/n_0/n_2"])
    assert streams.odometry is not None
    assert streams.odometry.t_ns.tolist() == [T0 + i * S for i in range(5)]
    assert streams.odometry.position_m[:, 0].tolist() == [0, 1, 2, 3, 4]
    assert (streams.odometry.frame_id, streams.odometry.child_frame_id) == ("odom", "base_link")
    assert streams.odometry_linear_mps is not None
    assert streams.odometry_linear_mps.tolist() == [[0.5, 0, 0]] * 5
    assert streams.odometry_angular_radps is not None
    assert streams.odometry_angular_radps[:, 2].tolist() == [0.25] * 5
    assert streams.ranges is not None
    assert streams.ranges.tag.tolist() == [0] * 5
    assert streams.ranges.anchor.tolist() == [2] * 5
    assert streams.ranges.range_m.tolist() == [1, 2, 3, 4, 5]
    assert streams.reference is None
    assert streams.imu is None
    assert streams.warnings == []


def test_late_stamps_are_sorted_in_and_repeated_ones_dropped_and_counted(log: Any) -> None:
    for i, stamp in enumerate([1, 4, 3, 3, 3, 5]):
        log.add("/odom", T0 + i, log.ros.odometry(T0 + stamp, float(i)))
    streams = gather(Recording(log.container), odometry="/odom")
    assert streams.odometry is not None
    assert (streams.odometry.t_ns - T0).tolist() == [1, 3, 4, 5]
    assert streams.odometry.position_m[:, 0].tolist() == [0, 2, 1, 5]
    assert streams.warnings == ["/odom: 2 of 6 messages have the stamp of another; they are dropped"]
    assert streams.losses == []


def test_a_clock_that_is_set_back_costs_all_topics_the_same_stretch(log: Any) -> None:
    """Ranges, odometry, a reference and tf at three rates, and tf with a second transform on another clock."""
    still = (0.0, 0.0, 0.0, 1.0)
    for i in range(1000):
        t_ns = T0 + i * S // 100
        stamp = t_ns if i < 600 else t_ns - 3 * S
        log.add("/truth", t_ns, log.ros.odometry(stamp, float(i)))
        if i % 2 == 0:
            moved = log.ros.transform(stamp, "odom", "base_link", (float(i), 0.0, 0.0), still)
            other = log.ros.transform(t_ns, "map", "odom", (float(i), 0.0, 0.0), still)
            log.add("/tf", t_ns, log.ros.tf(*([moved, other] if i % 4 else [moved])))
        if i % 5 == 0:
            log.add("/odom", t_ns, log.ros.odometry(stamp, float(i)))
            log.add("/uwb/n_0/n_2", t_ns, log.ros.range(stamp, float(i)))
    streams = gather(Recording(log.container), odometry="/odom", reference="/truth", uwb=["/uwb/n_0/n_2"], tf=["/tf"])
    first, second = streams.tf.pose_series("base_link", "odom"), streams.tf.pose_series("odom", "map")
    for step, found in (
        (1, streams.reference.position_m[:, 0]),
        (5, streams.odometry.position_m[:, 0]),
        (5, streams.ranges.range_m),
        (2, first.position_m[:, 0]),
    ):
        assert found.tolist() == [i for i in range(0, 1000, step) if i < 600 or i >= 900]
    assert second.position_m[:, 0].tolist() == [*range(2, 1000, 4)]
    assert {each.topic: each.count for each in streams.losses} == {
        "/truth": 300,
        "/odom": 60,
        "/uwb/n_0/n_2": 60,
        "/tf": 150,
    }
    by_log = gather(Recording(log.container, stamp="log"), odometry="/odom", reference="/truth", tf=["/tf"])
    assert len(by_log.reference.t_ns) == 1000
    assert by_log.losses == []


def test_transforms_of_several_publishers_that_come_late_are_no_loss(log: Any) -> None:
    """Two publishers of one transform, of which one comes 400 ms late."""
    still = (0.0, 0.0, 0.0, 1.0)
    for i in range(100):
        for late_ns in (0, 400_000_000):
            stamp = T0 + i * S // 20 - late_ns + late_ns // 40
            log.add(
                "/tf", T0 + i * S // 20, log.ros.tf(log.ros.transform(stamp, "map", "base_link", (i, 0.0, 0.0), still))
            )
    streams = gather(Recording(log.container), tf=["/tf"])
    assert len(streams.tf.pose_series("base_link", "map")) == 200
    assert (streams.warnings, streams.losses) == ([], [])


@pytest.mark.parametrize("ahead_ns", [60 * S, 10**18])
def test_a_stamp_in_the_future_costs_itself(log: Any, ahead_ns: int) -> None:
    for i in range(100):
        log.add("/odom", i * S, log.ros.odometry((i + 1) * S + (ahead_ns if i == 3 else 0), float(i)))
    streams = gather(Recording(log.container), odometry="/odom")
    assert streams.odometry is not None
    assert streams.odometry.position_m[:, 0].tolist() == [i for i in range(100) if i != 3]


def test_ranges_are_sorted_by_time_and_those_without_ids_are_left_out_and_counted(log: Any) -> None:
    for i, stamp in enumerate([2, 1, 3]):
        log.add("/uwb/n_0/n_2", T0 + i, log.ros.range(T0 + stamp, float(stamp)))
        log.add("/sonar", T0 + i, log.ros.range(T0 + stamp, 1.0))
    streams = gather(Recording(log.container), uwb=["/uwb/n_0/n_2", "/sonar"])
    assert streams.ranges is not None
    assert streams.ranges.range_m.tolist() == [1, 2, 3]
    assert "/sonar: 3 ranges without ids" in streams.warnings[0]
    assert "uwb.range_topics" in streams.warnings[0]


def test_ranges_of_a_clock_that_is_set_back_do_not_interleave(log: Any) -> None:
    """Two links on one clock, whose stamps repeat three of eight seconds, and one that is sound."""
    for i in range(8):
        stamp = T0 + (i if i < 5 else i - 3) * S
        log.add("/uwb/n_0/n_2", T0 + i * S, log.ros.range(stamp, 1.0 + i))
        log.add("/uwb/n_0/n_3", T0 + i * S, log.ros.range(stamp, 1.0 + i))
        log.add("/uwb/n_0/n_4", T0 + i * S, log.ros.range(T0 + i * S, 1.0 + i))
    topics = ["/uwb/n_0/n_2", "/uwb/n_0/n_3", "/uwb/n_0/n_4"]
    streams = gather(Recording(log.container), uwb=topics)
    assert streams.ranges is not None
    for anchor, expected in ((2, [1, 2, 3, 4, 5]), (3, [1, 2, 3, 4, 5]), (4, [1, 2, 3, 4, 5, 6, 7, 8])):
        assert streams.ranges.range_m[streams.ranges.anchor == anchor].tolist() == expected
    detail = (
        "its header stamps go back by 2.00 s, to 2023-11-14T22:13:22.000Z; 3 of 8 ranges whose stamps repeat or run "
        "ahead of others are dropped; take log times with  --stamp log"
    )
    assert streams.losses == [Loss("clock", detail, topic, 3) for topic in topics[:2]]
    by_log = gather(Recording(log.container, stamp="log"), uwb=topics)
    assert by_log.ranges is not None
    assert len(by_log.ranges) == 24
    assert by_log.losses == []


def test_static_transforms_count_from_before_the_window(log: Any) -> None:
    still = (0.0, 0.0, 0.0, 1.0)
    log.add("/tf_static", T0, log.ros.tf(log.ros.transform(T0, "base_link", "lidar", (0.0, 0.0, 0.4), still)))
    for i in range(10):
        log.add("/tf", T0 + i * S, log.ros.tf(log.ros.transform(T0 + i * S, "map", "base_link", (i, 0.0, 0.0), still)))
    topics = ["/tf", "/tf_static"]
    streams = gather(Recording(log.container), tf=topics, start_ns=T0 + 5 * S, end_ns=T0 + 8 * S)
    transform = streams.tf.static_transform("lidar", "base_link")
    assert transform is not None
    assert transform[2, 3] == pytest.approx(0.4)
    series = streams.tf.pose_series("lidar", "map")
    assert series is not None
    assert series.position_m[:, 0].tolist() == [5, 6, 7]
    np.testing.assert_allclose(series.position_m[:, 2], 0.4)
