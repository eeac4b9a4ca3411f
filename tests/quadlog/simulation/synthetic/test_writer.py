from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from quadlog.simulation.synthetic import follow
from quadlog.simulation.synthetic.recording import START_NS
from quadlog.simulation.synthetic.writer import WRITERS, write_recording

COUNTS = {
    "/lidar/points": 10,
    "/nlink_linktrack_tagframe0": 100,
    "/imu/data": 100,
    "/odom": 50,
    "/tf_static": 1,
    "/truth/robot/pose": 50,
    "/truth/person/pose": 50,
}


def write(folder: Path, container: str, seed: int = 3) -> Path:
    path = folder / f"walk.{container}"
    recording = follow.synthesize(seed=seed, duration_s=1.0, azimuth_steps=90)
    assert write_recording(WRITERS[container](path), recording.messages()) == COUNTS
    return path


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return {container: write(tmp_path_factory.mktemp("written"), container) for container in WRITERS}


def content(path):
    """(topic, log time, stamp, some of the content) of every message, by rosbags."""
    rows = []
    with AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        for connection, log_time_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            header = getattr(message, "header", None) or message.transforms[0].header
            stamp_ns = header.stamp.sec * 10**9 + header.stamp.nanosec
            if connection.topic == "/lidar/points":
                body = bytes(message.data)
            elif connection.topic == "/nlink_linktrack_tagframe0":
                body = (message.id, *message.dis_arr.tolist())
            elif connection.topic == "/imu/data":
                body = (message.orientation.z, message.angular_velocity.z, message.linear_acceleration.x)
            elif connection.topic == "/tf_static":
                body = message.transforms[0].transform.translation.z
            else:
                pose = message.pose.pose if connection.topic == "/odom" else message.pose
                body = (pose.position.x, pose.position.y, pose.orientation.z)
            rows.append((connection.topic, connection.msgtype, log_time_ns, stamp_ns, body))
    return rows


def test_the_three_containers_hold_the_same_messages(written):
    reference = content(written["mcap"])
    assert Counter(row[0] for row in reference) == COUNTS
    assert content(written["bag"]) == reference
    assert content(written["db3"]) == reference


@pytest.mark.parametrize("container", list(WRITERS))
def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(written, container, tmp_path):
    assert write(tmp_path, container).read_bytes() == written[container].read_bytes()
    assert list(tmp_path.iterdir()) == [tmp_path / f"walk.{container}"]
    other = tmp_path / "other"
    other.mkdir()
    assert write(other, container, seed=4).read_bytes() != written[container].read_bytes()


def test_mcap_reads_with_its_own_library_in_order_of_log_time(written):
    with written["mcap"].open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
        by_topic = {summary.channels[i].topic: n for i, n in summary.statistics.channel_message_counts.items()}
        assert by_topic == COUNTS
        rows = [
            (m.log_time, c.topic, m.sequence, d) for _, c, m, d in reader.iter_decoded_messages(log_time_order=False)
        ]
    times = [row[0] for row in rows]
    assert times == sorted(times)
    assert times[0] == START_NS
    scans = [(log_time, sequence, cloud) for log_time, topic, sequence, cloud in rows if topic == "/lidar/points"]
    assert [sequence for _, sequence, _ in scans] == list(range(10))
    for log_time, _, cloud in scans:
        assert log_time - (cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec) == 105_000_000
