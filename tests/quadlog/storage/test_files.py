from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from quadlog.storage.atomic_write import (
    is_part,
    part_prefix,
    remove_stale_parts,
    uninterrupted,
    whole_file,
    write_whole,
)


@pytest.mark.parametrize("error", [None, ValueError, KeyboardInterrupt, SystemExit])
def test_the_file_appears_at_the_end_and_an_interrupted_write_leaves_the_old_one(tmp_path: Path, error: Any) -> None:
    path = tmp_path / "metrics.json"
    path.write_bytes(b"old")
    with pytest.raises(error) if error else nullcontext(), whole_file(path) as part:
        part.write_bytes(b"all")
        assert path.read_bytes() == b"old"
        if error:
            raise error
    assert path.read_bytes() == (b"old" if error else b"all")
    assert [each.name for each in tmp_path.iterdir()] == ["metrics.json"]


def test_a_killed_process_leaves_no_file_of_the_final_name(tmp_path: Path) -> None:
    script = f"""
import os, signal
from pathlib import Path
from quadlog.results.tables import TABLES
from quadlog.results.tables import TableWriter
from quadlog.results.arrays import MapsWriter
import numpy as np
folder = Path({str(tmp_path)!r})
poses, shape = TABLES["poses"], (900, 900)
with TableWriter(folder / "poses.parquet", poses) as table, MapsWriter(folder / "maps.npz", 0.1, shape) as maps:
    n = 50_000
    table.append(dict(
        t_ns=np.arange(n), x_m=np.zeros(n), y_m=0.0, yaw_rad=0.0, source="uwb", z_m=0.0, roll_rad=0.0, pitch_rad=0.0))
    for t in range(50):
        maps.append(t, (0, 0), np.random.default_rng(t).random(shape) < 0.5)
    os.kill(os.getpid(), signal.SIGKILL)
"""
    killed = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    left = sorted(tmp_path.iterdir())
    assert len(left) == 2
    assert all(is_part(path.name) and path.stat().st_size > 10_000 for path in left)  # it was in the middle
    remove_stale_parts(tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_full_disk_is_one_line_and_no_file(tmp_path: Path) -> None:
    script = f"""
import resource
from pathlib import Path
from quadlog.errors import CannotWrite
from quadlog.results.tables import TABLES
from quadlog.results.tables import write_table
from quadlog.results.arrays import MapsWriter
from quadlog.storage.atomic_write import write_whole
import numpy as np
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
folder = Path({str(tmp_path)!r})
def table():
    random = np.random.default_rng(0).random(100_000)
    write_table(folder / "poses.parquet", TABLES["poses"], dict(
        t_ns=np.arange(100_000), x_m=random, y_m=random, yaw_rad=0.0, source="uwb",
        z_m=0.0, roll_rad=0.0, pitch_rad=0.0))
def maps():
    with MapsWriter(folder / "maps.npz", 0.1, (900, 900)) as maps:
        for t in range(50):
            maps.append(t, (0, 0), np.random.default_rng(t).random((900, 900)) < 0.5)
for write in (table, maps, lambda: write_whole(folder / "big", bytes(200_000))):
    try:
        write()
    except CannotWrite as error:
        print(error)
"""
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    lines = run.stdout.splitlines()
    assert [line.split(": ")[0] for line in lines] == [str(tmp_path / n) for n in ("poses.parquet", "maps.npz", "big")]
    assert all("cannot be written: " in line for line in lines)
    assert not list(tmp_path.iterdir())


def test_a_link_of_the_final_name_is_replaced_not_followed(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.write_bytes(b"precious")
    (tmp_path / "a").symlink_to(other)
    write_whole(tmp_path / "a", b"new")
    assert other.read_bytes() == b"precious"
    assert not (tmp_path / "a").is_symlink()


def test_cleaning_keeps_what_others_may_be_writing(tmp_path: Path, left_part: str) -> None:
    """Own files, those of another process that runs, of another host, and of an older quadlog.

    A day later also the last two: what a living process writes is never left, whatever a clock says.
    """
    elsewhere = ".quadlog-" + "0" * 8 + left_part[len(".quadlog-") + 8 :]
    names = [f"{part_prefix(pid)}00000001.part" for pid in (os.getpid(), os.getppid())]
    names += [elsewhere, ".quadlog-1-2.part"]
    (tmp_path / ".quadlog-folder.part").mkdir()
    for name in (*names, left_part, "notes.part"):
        (tmp_path / name).write_bytes(b"")
    remove_stale_parts(tmp_path)
    kept = {".quadlog-folder.part", "notes.part"}
    assert {path.name for path in tmp_path.iterdir()} == {*names, *kept}
    for name in names:
        os.utime(tmp_path / name, (time.time() - 25 * 3600,) * 2)
    remove_stale_parts(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {*names[:2], *kept}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_waits_for_files_that_belong_together_and_comes_then(number: signal.Signals) -> None:
    came: list[int] = []
    before = signal.signal(number, lambda number, _: came.append(number))
    try:
        with uninterrupted():
            signal.raise_signal(number)
            assert came == []
        assert came == [number]
        signal.raise_signal(number)
        assert came == [number] * 2
    finally:
        signal.signal(number, before)


def test_writers_and_cleaners_at_once_lose_nothing(tmp_path: Path) -> None:
    """Four processes write one name and clean up behind each other: the file is whole each time it is looked at."""
    script = f"""
import sys
from pathlib import Path
from quadlog.storage.atomic_write import remove_stale_parts, write_whole
for number in range(50):
    write_whole(Path({str(tmp_path)!r}) / "run.json", sys.argv[1].encode() * 100_000)
    remove_stale_parts(Path({str(tmp_path)!r}))
"""
    writers = [subprocess.Popen([sys.executable, "-c", script, letter]) for letter in "abcd"]
    while any(writer.poll() is None for writer in writers):
        if (tmp_path / "run.json").exists():
            content = (tmp_path / "run.json").read_bytes()
            assert len(content) == 100_000
            assert len(set(content)) == 1
    assert [writer.wait() for writer in writers] == [0] * 4
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]
