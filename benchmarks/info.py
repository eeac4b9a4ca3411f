"""`quadlog info` on an indexed recording of 1 GB: whole processes, in turn with their imports alone."""

from __future__ import annotations

import statistics
import struct
import sys
from collections.abc import Iterator
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from benchmarks.figures import QUADLOG, Figure, run_apart, run_quadlog, run_timed
from benchmarks.reading import SCANS, write_clouds

ROUNDS, REPEATS, SMALL_PER_SCAN = 7, 8, 20
IMPORTS = "import quadlog.cli.main, quadlog.cli.info, quadlog.config.file, quadlog.pipelines.info"
IMPORTS += ", quadlog.cli.progress, quadlog.recordings.containers.open"


def measure(folder: Path) -> Iterator[Figure]:
    """Wall time and what it is above the imports; `--full` once, for comparison."""
    path = run_apart(write_gigabyte, folder)
    commands = [QUADLOG, "info", str(path)], [sys.executable, "-c", IMPORTS]
    pairs = [[run_timed(command).wall for command in commands] for _ in range(ROUNDS)]
    imports_s = statistics.median(imports for _, imports in pairs)
    floor = f"floor: its imports alone take {imports_s:.2f} s"
    size = f"{path.stat().st_size / 1e9:.1f} GB"
    yield Figure(f"quadlog info, indexed MCAP of {size}", statistics.median(s for s, _ in pairs), "s", 0.6, floor=floor)
    yield Figure("the same, above its imports", statistics.median(whole - imports for whole, imports in pairs), "s")
    yield Figure("quadlog info --full", run_quadlog("info", "--full", str(path)).wall, "s")
    path.unlink()


def write_gigabyte(folder: Path) -> Path:
    """Scans at 10 Hz, the same ones again and again with stamps that go on, and small messages at 200 Hz."""
    scans, path = write_clouds(folder / "scans.mcap"), folder / "gigabyte.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="quadlog-bench")
        text = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        small = writer.register_channel("/chatter", "cdr", text)
        with scans.open("rb") as source:
            reader = make_reader(source)
            summary = reader.get_summary()
            assert summary is not None
            (schema,) = summary.schemas.values()
            clouds = writer.register_channel(
                "/points", "cdr", writer.register_schema(schema.name, schema.encoding, schema.data)
            )
            for repeat in range(REPEATS):
                for _, _, message in reader.iter_messages():
                    _write_tenth(writer, clouds, small, message.log_time + repeat * SCANS * 10**8, message.data)
        writer.finish()
    scans.unlink()
    return path


def _write_tenth(writer: Writer, clouds: int, small: int, t_ns: int, scan: bytes) -> None:
    payload = bytearray(scan)
    struct.pack_into("<iI", payload, 4, t_ns // 10**9, t_ns % 10**9)
    writer.add_message(clouds, t_ns, bytes(payload), t_ns)
    for index in range(SMALL_PER_SCAN):
        each_ns = t_ns + index * 10**8 // SMALL_PER_SCAN
        writer.add_message(small, each_ns, b"\0\1\0\0\5\0\0\0tick\0", each_ns)
