"""Reading: clouds against reading and decompressing alone, and `quadlog info` of a gigabyte."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from benchmarks.figures import Figure, run_apart, run_python, run_quadlog, synthesize
from quadlog.messages import PointCloud
from quadlog.recordings.recording import open_recording

LENGTH_S, AZIMUTH_STEPS, ROUNDS, REPEATS = 60, 1875, 7, 6
TOPIC = "/lidar/points"
IMPORTS = "import quadlog.cli.main, quadlog.cli.info, quadlog.config.file, quadlog.pipelines.info"
IMPORTS += ", quadlog.cli.progress, quadlog.recordings.containers.open"


def measure(folder: Path) -> Iterator[Figure]:
    """All with a minute of 30 000 points a scan. Reading ahead needs a free core; CPU time is what is left without."""
    path, _ = synthesize(folder, LENGTH_S, AZIMUTH_STEPS)
    pairs = [(_times_ms(lambda: _read_decoded(path)), _times_ms(lambda: decompress(path))) for _ in range(ROUNDS)]
    scans = _read_decoded(path)
    floor_ms = statistics.median(alone[0] for _, alone in pairs) / scans
    wall, cpu = (statistics.median(decoded[clock] / alone[clock] for decoded, alone in pairs) for clock in (0, 1))
    floor = f"floor: reading and decompressing take {floor_ms:.2f} ms a scan"
    yield Figure("zstd MCAP, clouds read and decoded / decompressed", wall, "x", 1.3, floor=floor)
    yield Figure("the same in CPU time of all threads", cpu, "x")
    yield from _info(path, folder)


def _info(path: Path, folder: Path) -> Iterator[Figure]:
    large = run_apart(_write_gigabyte, path, folder / "gigabyte.mcap")
    pairs = [(run_quadlog("info", str(large)).wall, run_python(IMPORTS).wall) for _ in range(ROUNDS)]
    floor = f"floor: its imports alone take {statistics.median(alone for _, alone in pairs):.2f} s"
    size = f"{large.stat().st_size / 1e9:.1f} GB"
    seconds = statistics.median(info for info, _ in pairs)
    yield Figure(f"quadlog info, indexed MCAP of {size}", seconds, "s", 0.6, floor=floor)
    yield Figure("quadlog info --full", run_quadlog("info", "--full", str(large)).wall, "s")


def _write_gigabyte(path: Path, large: Path) -> Path:
    """The same messages again and again, later each time, in chunks that are not compressed."""
    with path.open("rb") as source, large.open("wb") as target:
        reader, writer = make_reader(source), Writer(target, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="quadlog-bench")
        channels: dict[int, int] = {}
        for repeat in range(REPEATS):
            for schema, channel, message in reader.iter_messages():
                assert schema is not None
                if channel.id not in channels:
                    schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
                t_ns = message.log_time + repeat * LENGTH_S * 10**9
                writer.add_message(channels[channel.id], t_ns, message.data, t_ns)
        writer.finish()
    return large


def _read_decoded(path: Path) -> int:
    with open_recording(path) as recording:
        return sum(isinstance(each.message, PointCloud) for each in recording.messages([TOPIC]))


def decompress(path: Path) -> None:
    """Every chunk's records decompressed, and nothing looked at: what no reader can do without."""
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        decompressor = zstandard.ZstdDecompressor()
        for chunk in summary.chunk_indexes:
            # Before the records: opcode, length, start, end, size, CRC, the name of the compression, their length.
            stream.seek(chunk.chunk_start_offset + 9 + 8 + 8 + 8 + 4 + 4 + len(chunk.compression) + 8)
            decompressor.decompress(stream.read(chunk.compressed_size), max_output_size=chunk.uncompressed_size)


def _times_ms(action: Callable[[], object]) -> tuple[float, float]:
    """Wall time and CPU time."""
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    action()
    return (time.perf_counter() - wall_s) * 1e3, (time.process_time() - cpu_s) * 1e3
