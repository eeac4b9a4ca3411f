from __future__ import annotations

from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from quadlog.simulation.synthetic import follow
from quadlog.simulation.synthetic.recording import START_NS
from quadlog.simulation.synthetic.writer import write_recording

COUNTS = {
    "/lidar/points": 10,
    "/nlink_linktrack_tagframe0": 100,
    "/imu/data": 100,
    "/odom": 50,
    "/tf_static": 1,
    "/truth/robot/pose": 50,
    "/truth/person/pose": 50,
}


def write(folder: Path, seed: int = 3) -> Path:
    recording = follow.synthesize(seed=seed, duration_s=1.0, azimuth_steps=16)
    assert write_recording(folder / "walk.mcap", recording.messages()) == COUNTS
    return folder / "walk.mcap"


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(tmp_path):
    one, same, other = write(tmp_path).read_bytes(), write(tmp_path).read_bytes(), write(tmp_path, seed=4).read_bytes()
    assert one == same
    assert one != other


def test_mcap_reads_with_its_own_library_in_order_of_log_time(tmp_path):
    with write(tmp_path).open("rb") as stream:
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
