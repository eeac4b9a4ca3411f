from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadlog.errors import CannotWrite
from quadlog.results.arrays import MapsWriter
from quadlog.results.tables import TABLES, write_table
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
from quadlog.storage.atomic_write import whole_file
with whole_file(Path({str(tmp_path / "run.json")!r})) as part:
    part.write_bytes(bytes(20_000))
    os.kill(os.getpid(), signal.SIGKILL)
"""
    killed = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    (left,) = tmp_path.iterdir()
    assert (is_part(left.name), left.stat().st_size) == (True, 20_000)  # it was in the middle
    remove_stale_parts(tmp_path)
    assert not list(tmp_path.iterdir())


def write_poses(folder: Path) -> None:
    columns = dict.fromkeys(TABLES["poses"].names, np.random.default_rng(0).random(100_000))
    table = columns | {"t_ns": np.arange(100_000), "source": "uwb"}
    write_table(folder / "poses.parquet", TABLES["poses"], table)


def write_maps(folder: Path) -> None:
    with MapsWriter(folder / "maps.npz", 0.1, (900, 900)) as maps:
        for t in range(50):
            maps.append(t, (0, 0), np.random.default_rng(t).random((900, 900)) < 0.5)


BIG = bytes(200_000)
WRITERS = {"poses.parquet": write_poses, "maps.npz": write_maps, "big": lambda folder: write_whole(folder / "big", BIG)}


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_one_line_and_no_file(tmp_path: Path, name: str, limited: Any) -> None:
    limited(resource.RLIMIT_FSIZE, 100_000)
    with pytest.raises(CannotWrite) as caught:
        WRITERS[name](tmp_path)
    assert str(caught.value).startswith(f"{tmp_path / name}: cannot be written: ")
    assert "\n" not in str(caught.value)
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
    """Three processes write one name and clean up behind each other: the file is whole each time it is looked at."""
    script = f"""
import sys
from pathlib import Path
from quadlog.storage.atomic_write import remove_stale_parts, write_whole
for number in range(30):
    write_whole(Path({str(tmp_path)!r}) / "run.json", sys.argv[1].encode() * 100_000)
    remove_stale_parts(Path({str(tmp_path)!r}))
"""
    writers = [subprocess.Popen([sys.executable, "-c", script, letter]) for letter in "abc"]
    while any(writer.poll() is None for writer in writers):
        if (tmp_path / "run.json").exists():
            content = (tmp_path / "run.json").read_bytes()
            assert len(content) == 100_000
            assert len(set(content)) == 1
    assert [writer.wait() for writer in writers] == [0] * 3
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]
