"""Recordings with something odd about their files, replayed to the map: what is read, warned of and lost."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from quadlog.simulation.synthetic.recording import LIDAR_TOPIC, START_NS
from quadlog.simulation.synthetic.ros_encoding import RosEncoder
from tests.lab.clouds import SCANS, SOURCES, rows, stamped
from tests.lab.recordings import Row, flip, written

HOUR_NS, MINUTE_NS, S_NS = 3_600_000_000_000, 60_000_000_000, 1_000_000_000


def split(folder: Path) -> Path:
    folder.mkdir()
    for part, half in enumerate((rows()[: len(rows()) // 2], rows()[len(rows()) // 2 :])):
        written(folder / f"walk_{part}.mcap", half)
    return folder


def one_more_promised(writer: Writer) -> None:
    statistics = writer._Writer__statistics
    statistics.message_count += 1
    statistics.channel_message_counts[max(statistics.channel_message_counts)] += 1


def with_a_broken_cloud(path: Path) -> Path:
    """Every message in a chunk of its own, and a byte of a cloud turned over, which nobody reads before `filter`."""
    written(path, rows(), chunk_size=1)
    with path.open("rb") as file:
        largest = max(make_reader(file).get_summary().chunk_indexes, key=lambda chunk: chunk.chunk_length)
    return flip(path, largest.chunk_start_offset + largest.chunk_length // 2)


def one(changed: Callable[[int, Any], Any]) -> Callable[[Path], Path]:
    """One cloud of sixteen changed, given its log time."""

    def write(folder: Path) -> Path:
        return written(
            folder / "r.mcap", rows(lambda n, log_ns, scan: (log_ns, changed(log_ns, scan) if n == 9 else scan))
        )

    return write


def is_early_cloud(row: Row) -> bool:
    return row[0] == LIDAR_TOPIC and row[1] < START_NS + S_NS


class File(NamedTuple):
    """How a recording is written, and what is read of it: scans, the only warning's words, causes of losses."""

    make: Callable[[Path], Path]
    scans: int = SCANS
    warning: str = ""
    losses: tuple[tuple[str, int], ...] = ()


FILES = {
    "split": File(lambda folder: split(folder / "walk")),
    "a stray stamp": File(one(lambda log_ns, scan: stamped(scan, log_ns + 2 * HOUR_NS)), 15, "more than an hour from"),
    "a stamp of 0": File(one(lambda _, scan: stamped(scan, 0)), warning="1 messages have the stamp 0"),
    "not to be decoded": File(one(lambda _, scan: RosEncoder().encode(scan)[:200]), 15, losses=(("decode", 1),)),
    "a broken cloud": File(lambda folder: with_a_broken_cloud(folder / "r.mcap"), 15, losses=(("crc", 1),)),
    "fewer than promised": File(
        lambda folder: written(folder / "r.mcap", rows(), before_end=one_more_promised), losses=(("count", 1),)
    ),
    "rows written late": File(
        lambda folder: written(folder / "r.db3", sorted(rows(), key=is_early_cloud)), warning="log time goes back"
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_what_is_read_of_a_file_and_what_is_lost(name, tmp_path, replayed):
    file = FILES[name]
    path = file.make(tmp_path)
    done = replayed(path, *SOURCES, "--set", "grid.size_cells=81")
    assert tuple((loss["cause"], loss["count"]) for loss in done.record["losses"]) == file.losses
    assert done.code == (3 if file.losses else 0)
    assert done.record["counts"]["scans"] == len(done.table("scans")["t_ns"]) == file.scans
    assert [file.warning in text for text in done.warned] == ([True] if file.warning else [])
    if path.is_file():
        assert done.record["input"]["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()


def test_two_clocks_are_refused(tmp_path, replayed):
    apart = rows(lambda n, log_ns, scan: (log_ns, stamped(scan, log_ns + 35 * MINUTE_NS)), beside_ns=-35 * MINUTE_NS)
    done = replayed(written(tmp_path / "r.mcap", apart), *SOURCES)
    assert (done.code, "/lidar/points lie 4200 s apart" in done.err) == (1, True)
