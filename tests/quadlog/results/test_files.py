from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from quadlog.errors import CannotWrite
from quadlog.results.files import is_part, remove_stale_parts, whole_file, write_whole


def test_the_file_appears_only_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "metrics.json"
    with whole_file(path) as part:
        part.write_bytes(b"all")
        assert not path.exists()
    assert path.read_bytes() == b"all"
    assert [each.name for each in tmp_path.iterdir()] == ["metrics.json"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path: Path, error: type) -> None:
    path = tmp_path / "metrics.json"
    path.write_bytes(b"old")

    def interrupted() -> None:
        with whole_file(path) as part:
            part.write_bytes(b"ne")
            raise error

    with pytest.raises(error):
        interrupted()
    assert path.read_bytes() == b"old"
    assert [each.name for each in tmp_path.iterdir()] == ["metrics.json"]


def test_a_killed_process_leaves_no_file_of_the_final_name(tmp_path: Path) -> None:
    script = f"""
import os, signal
from pathlib import Path
from quadlog.results.schemas import TABLES
from quadlog.results.tables import TableWriter
from quadlog.results.maps import MapsWriter
import numpy as np
folder = Path({str(tmp_path)!r})
poses, shape = TABLES["poses"], (900, 900)
with TableWriter(folder / "poses.parquet", poses) as table, MapsWriter(folder / "maps.npz", 0.1, shape) as maps:
    n = 50_000
    table.append(dict(t_ns=np.arange(n), x_m=np.zeros(n), y_m=0.0, yaw_rad=0.0, source="uwb"))
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
from quadlog.results.schemas import TABLES
from quadlog.results.tables import write_table
from quadlog.results.maps import MapsWriter
from quadlog.results.files import write_whole
import numpy as np
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
folder = Path({str(tmp_path)!r})
def table():
    random = np.random.default_rng(0).random(100_000)
    write_table(folder / "poses.parquet", TABLES["poses"], dict(
        t_ns=np.arange(100_000), x_m=random, y_m=random, yaw_rad=0.0, source="uwb"))
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


def test_a_missing_folder_and_a_folder_in_the_way_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(CannotWrite, match="No such file"):
        write_whole(tmp_path / "gone" / "a", b"")
    (tmp_path / "b").mkdir()
    with pytest.raises(CannotWrite, match="cannot be written"):
        write_whole(tmp_path / "b", b"")
    assert [each.name for each in tmp_path.iterdir()] == ["b"]


def test_an_error_of_reading_inside_the_block_stays_what_it_is(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), whole_file(tmp_path / "a"):
        (tmp_path / "input").read_bytes()


def test_a_link_of_the_final_name_is_replaced_not_followed(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.write_bytes(b"precious")
    (tmp_path / "a").symlink_to(other)
    write_whole(tmp_path / "a", b"new")
    assert other.read_bytes() == b"precious"
    assert not (tmp_path / "a").is_symlink()


def test_cleaning_keeps_what_is_not_ours(tmp_path: Path) -> None:
    (tmp_path / ".quadlog-1-2.part").write_bytes(b"")
    (tmp_path / ".quadlog-folder.part").mkdir()
    (tmp_path / "notes.part").write_bytes(b"")
    remove_stale_parts(tmp_path)
    assert sorted([each.name for each in tmp_path.iterdir()]) == [".quadlog-folder.part", "notes.part"]
