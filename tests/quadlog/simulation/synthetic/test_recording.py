from __future__ import annotations

import numpy as np
import pytest

from quadlog.simulation.sensors.lidar import SimulatedScan
from quadlog.simulation.synthetic import follow
from quadlog.simulation.synthetic.recording import LIDAR_TOPIC, START_NS, UWB_TOPIC


def stamps(messages, topic):
    own = [each.message for each in messages if each.topic == topic]
    return [each.cloud.stamp_ns if isinstance(each, SimulatedScan) else each.stamp_ns for each in own]


def test_messages_come_in_order_of_log_time_and_at_their_rates(short):
    messages = list(short.messages())
    times = [message.log_time_ns for message in messages]
    assert times == sorted(times)
    for topic, hz in (
        ("/imu/data", 100),
        ("/odom", 50),
        ("/truth/robot/pose", 50),
        ("/truth/person/pose", 50),
        (LIDAR_TOPIC, 10),
    ):
        assert np.unique(np.diff(stamps(messages, topic))).tolist() == [10**9 // hz]
    for tag in (0, 1):
        own = [m for m in messages if m.topic == UWB_TOPIC and m.message.tag == tag]
        assert np.unique(np.diff([m.log_time_ns for m in own])).tolist() == [20_000_000]
        assert all(m.log_time_ns == m.message.stamp_ns for m in own)


@pytest.mark.parametrize("duration_s", [0.1, 0.95, 1.0, 1.05])
def test_every_sweep_ends_within_the_recording(duration_s):
    recording = follow.synthesize(seed=0, duration_s=duration_s, azimuth_steps=16)
    scans = stamps(recording.messages(), LIDAR_TOPIC)
    assert len(scans) == int(duration_s * 10 + 1e-9)
    assert scans[-1] + 100_000_000 <= START_NS + round(duration_s * 1e9)


def test_the_number_of_rays_does_not_affect_other_sensors():
    thin, thick = (follow.synthesize(seed=0, duration_s=0.5, azimuth_steps=n) for n in (16, 64))
    for ours, theirs in zip(thin.ranges, thick.ranges, strict=True):
        np.testing.assert_array_equal(ours.range_m, theirs.range_m)
