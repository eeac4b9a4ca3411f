"""Reading: decoded point clouds against reading and decompressing the same file alone."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import zstandard
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from benchmarks.figures import Figure, run_apart
from quadlog.messages import PointCloud
from quadlog.recordings.recording import open_recording

SCANS, POINTS, STEP = 200, 30_000, 22
ROUNDS = 7


def measure(folder: Path) -> Iterator[Figure]:
    """Time per scan of 30 000 points, in turns; the ratios pair by pair.

    Reading ahead needs a second core that is free; the ratio of CPU times is what is left without one.
    """
    path = run_apart(write_clouds, folder / "clouds.mcap")
    pairs = [(_times_ms(lambda: _read_decoded(path)), _times_ms(lambda: decompress(path))) for _ in range(ROUNDS)]
    decoded_ms = statistics.median(decoded[0] for decoded, _ in pairs) / SCANS
    floor_ms = statistics.median(alone[0] for _, alone in pairs) / SCANS
    wall, cpu = (statistics.median(decoded[clock] / alone[clock] for decoded, alone in pairs) for clock in (0, 1))
    floor = f"floor: reading and decompressing take {floor_ms:.2f} ms"
    yield Figure("zstd MCAP, read and decoded, per scan", decoded_ms, "ms", floor=floor)
    yield Figure("zstd MCAP, read and decoded / decompressed", wall, "x", 1.3)
    yield Figure("zstd MCAP, the same in CPU time of all threads", cpu, "x")


def write_clouds(path: Path) -> Path:
    """Scans as a 16-beam lidar gives them: x, y, z, intensity, ring and time."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind, field, header, stamp = (
        store.types[name]
        for name in (
            "sensor_msgs/msg/PointCloud2",
            "sensor_msgs/msg/PointField",
            "std_msgs/msg/Header",
            "builtin_interfaces/msg/Time",
        )
    )
    layout = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 7), ("ring", 16, 4), ("time", 18, 7)]
    fields = [field(name, offset, datatype, 1) for name, offset, datatype in layout]
    text, _ = store.generate_msgdef("sensor_msgs/msg/PointCloud2", ros_version=2)
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="quadlog-bench")
        schema = writer.register_schema("sensor_msgs/msg/PointCloud2", "ros2msg", text.encode())
        channel = writer.register_channel("/points", "cdr", schema)
        for index in range(SCANS):
            head = header(stamp(100 + index // 10, index % 10 * 100_000_000), "lidar")
            body = kind(head, 1, POINTS, fields, False, STEP, STEP * POINTS, _points(index), True)
            t_ns = 100 * 10**9 + index * 10**8
            payload = store.serialize_cdr(body, "sensor_msgs/msg/PointCloud2")
            writer.add_message(channel, t_ns, bytes(payload), t_ns)
        writer.finish()
    return path


def _points(seed: int) -> np.ndarray:
    """One scan (POINTS * STEP,) of bytes: rings about the sensor with 2 cm of noise, rounded to 2 mm."""
    generator = np.random.default_rng(seed)
    ring = np.arange(POINTS) % 16
    azimuth = np.arange(POINTS) * (2 * np.pi / POINTS)
    elevation = np.radians(-15 + 2 * ring)
    range_m = np.round((5 + 3 * np.sin(3 * azimuth) + generator.normal(0, 0.02, POINTS)) / 0.002) * 0.002
    rows = np.zeros(POINTS, dtype=[("xyzi", "<f4", 4), ("ring", "<u2"), ("time", "<f4")])
    rows["xyzi"][:, 0] = range_m * np.cos(elevation) * np.cos(azimuth)
    rows["xyzi"][:, 1] = range_m * np.cos(elevation) * np.sin(azimuth)
    rows["xyzi"][:, 2] = range_m * np.sin(elevation)
    rows["xyzi"][:, 3] = generator.integers(0, 255, POINTS)
    rows["ring"], rows["time"] = ring, azimuth / (2 * np.pi) * 0.1
    return rows.view(np.uint8).reshape(-1)


def _read_decoded(path: Path) -> None:
    with open_recording(path) as recording:
        messages = (each.message for each in recording.messages(["/points"]))
        clouds = [len(message.xyz_m) for message in messages if isinstance(message, PointCloud)]
    assert clouds == [POINTS] * SCANS


def decompress(path: Path) -> None:
    """Every chunk's records decompressed, and nothing looked at: what no reader can do without."""
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        decompressor = zstandard.ZstdDecompressor()
        for chunk in summary.chunk_indexes:
            # Before the records: opcode, length, start, end, size, CRC, the name of the compression, their length.
            stream.seek(chunk.chunk_start_offset + 9 + 8 + 8 + 8 + 4 + 4 + len(chunk.compression) + 8)
            records = stream.read(chunk.compressed_size)
            if chunk.compression:
                decompressor.decompress(records, max_output_size=chunk.uncompressed_size)


def _times_ms(action: Callable[[], None]) -> tuple[float, float]:
    """Wall time and CPU time."""
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    action()
    return (time.perf_counter() - wall_s) * 1e3, (time.process_time() - cpu_s) * 1e3
