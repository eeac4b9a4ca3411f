"""Between a folder that is claimed and a run that is begun: what was there stays until the new one is sure to start."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

import pytest

from quadlog.errors import AlreadyExists
from quadlog.results.run.run_folder import RunFolder
from quadlog.storage.atomic_write import part_prefix


def content_of_files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}


def test_a_claimed_run_loses_nothing_until_it_is_begun(tiny_run: Path, left_part: str) -> None:
    (tiny_run / left_part).write_bytes(b"left by a kill")
    (tiny_run / "plots").mkdir()
    (tiny_run / "plots" / "ranges.png").write_bytes(b"")
    with pytest.raises(AlreadyExists):
        RunFolder.claim(tiny_run)
    before = {name: data for name, data in content_of_files(tiny_run).items() if name != left_part}
    folder = RunFolder.claim(tiny_run, replace=True)
    assert content_of_files(tiny_run) == before
    folder.begin({"planner": {"name": "astar"}}, keep=("poses.parquet", "stages.json"))
    assert sorted(content_of_files(tiny_run)) == ["config.toml", "poses.parquet"]
    assert not (tiny_run / "plots").exists()
    assert (tiny_run / "poses.parquet").read_bytes() == before["poses.parquet"]
    assert tomllib.loads((tiny_run / "config.toml").read_text()) == {"planner": {"name": "astar"}}


@pytest.mark.parametrize("dies_at", range(4))
def test_a_run_that_is_begun_and_killed_is_unfinished_and_still_quadlogs(
    tiny_run: Path, monkeypatch: pytest.MonkeyPatch, dies_at: int
) -> None:
    (tiny_run / "run.json").touch()
    removed, unlink = [], Path.unlink

    def dying_unlink(path: Path, missing_ok: bool = False) -> None:
        if len(removed) == dies_at + 1:
            raise KeyboardInterrupt
        removed.append(path.name)
        unlink(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", dying_unlink)
    with pytest.raises(KeyboardInterrupt):
        RunFolder.claim(tiny_run, replace=True).begin({}, ())
    monkeypatch.undo()
    assert removed[0] == "run.json"
    assert not RunFolder(tiny_run).is_finished("ab" * 32, {}, "0.1.0", {})
    RunFolder.claim(tiny_run, replace=True).begin({}, ())
    assert sorted(content_of_files(tiny_run)) == ["config.toml"]


def test_two_that_take_one_folder_away_do_not_stumble(tmp_path: Path) -> None:
    folder = RunFolder.claim(tmp_path / "run")
    (tmp_path / "run").rmdir()
    folder.discard_if_empty()
    assert not (tmp_path / "run").exists()


def test_a_file_that_another_has_begun_keeps_the_folder(tmp_path: Path) -> None:
    folder = RunFolder.claim(tmp_path / "run")
    folder.write_config({})
    part = tmp_path / "run" / f"{part_prefix(os.getpid())}00000000.part"
    part.write_bytes(b"")
    folder.discard_if_empty()
    assert part.exists()
