from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from quadlog.errors import AlreadyExists, CannotWrite, NotARun
from quadlog.results.find_runs import OWN_FILES
from quadlog.results.record import read_record
from quadlog.results.saved.run_folder import RunFolder, read_metrics
from quadlog.storage.atomic_write import part_prefix


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}


def test_the_same_run_has_the_same_bytes(write_run: Callable[[Path], Path], tmp_path: Path) -> None:
    one, other = content(write_run(tmp_path / "a")), content(write_run(tmp_path / "b"))
    assert one == other
    of_some_logs = {"reference.tum", "joints.parquet", "other_poses.parquet", "body.parquet", "gait.parquet"}
    assert set(one) == OWN_FILES - {"report.html", "stages.json"} - of_some_logs


def test_an_existing_run_needs_a_flag(tiny_run: Path) -> None:
    before = content(tiny_run)
    with pytest.raises(AlreadyExists, match=r"--force.*--resume"):
        RunFolder.create(tiny_run)
    assert content(tiny_run) == before


def test_force_removes_what_is_ours_and_nothing_else(tiny_run: Path, left_part: str) -> None:
    (tiny_run / "plots").mkdir()
    (tiny_run / "plots" / "ranges.png").write_bytes(b"")
    (tiny_run / "plots" / left_part).write_bytes(b"")
    (tiny_run / "plots" / "mine.svg").write_bytes(b"drawn by hand")
    (tiny_run / "notes.md").write_bytes(b"precious")
    (tiny_run / "mine").mkdir()
    (tiny_run / "mine" / "run.json").write_bytes(b"precious too")
    (tiny_run / left_part).write_bytes(b"left by a kill")
    RunFolder.create(tiny_run, force=True)
    assert sorted([each.name for each in tiny_run.iterdir()]) == ["mine", "notes.md", "plots"]
    assert [each.name for each in (tiny_run / "plots").iterdir()] == ["mine.svg"]
    assert (tiny_run / "mine" / "run.json").read_bytes() == b"precious too"


@pytest.mark.parametrize("name", ["notes.md", "config.toml", "run.json", "map.pgm", "poses.parquet"])
@pytest.mark.parametrize("flags", [{}, {"force": True}])
def test_a_folder_of_something_else_is_never_touched(tmp_path: Path, name: str, flags: dict[str, bool]) -> None:
    (tmp_path / name).write_bytes(b'{"name": "not ours"}')
    (tmp_path / ".quadlog-1-0.part").write_bytes(b"")
    with pytest.raises(CannotWrite, match="holds other files and is no run of quadlog"):
        RunFolder.create(tmp_path, **flags)
    assert sorted([each.name for each in tmp_path.iterdir()]) == sorted([".quadlog-1-0.part", name])


def test_nothing_behind_a_link_is_removed(tiny_run: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "picture.png").write_bytes(b"precious")
    (outside / "map.yaml").write_bytes(b"precious")
    (tiny_run / "plots").symlink_to(outside)
    (tiny_run / "map.yaml").unlink()
    (tiny_run / "map.yaml").symlink_to(outside / "map.yaml")
    link = tmp_path / "link"
    link.symlink_to(tiny_run)
    before = content(tiny_run.with_name("outside"))
    with pytest.raises(CannotWrite, match="symbolic link"):
        RunFolder.create(link, force=True)
    assert (tiny_run / "run.json").exists()
    RunFolder.create(tiny_run, force=True)
    assert [each.name for each in tiny_run.iterdir()] == []
    assert content(outside) == before


def test_a_file_in_the_way_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "run").write_bytes(b"")
    with pytest.raises(CannotWrite, match="File exists"):
        RunFolder.create(tmp_path / "run", force=True)
    with pytest.raises(CannotWrite, match="Not a directory"):
        RunFolder.create(tmp_path / "run" / "deeper")


def test_a_run_of_another_format_needs_force(tiny_run: Path) -> None:
    (tiny_run / "run.json").write_text('{"run_format": 2}')
    (tiny_run / "config.toml").unlink()  # whose it is, run.json says as well
    with pytest.raises(AlreadyExists):
        RunFolder.create(tiny_run)
    RunFolder.create(tiny_run, force=True)
    assert not (tiny_run / "run.json").exists()


def test_a_killed_run_can_be_taken_over(tmp_path: Path, left_part: str) -> None:
    (tmp_path / left_part).write_bytes(b"killed before anything was whole")
    RunFolder.create(tmp_path).write_config({"planner": {"name": "astar", "none": None}})
    assert list(content(tmp_path)) == ["config.toml"]
    assert tomllib.loads((tmp_path / "config.toml").read_text()) == {"planner": {"name": "astar"}}
    with pytest.raises(AlreadyExists):
        RunFolder.create(tmp_path)


SOUND = {"value": 2, "n": 5, "unit": "m"}
UNSOUND = ('"x"', "true", "null", "[]", "NaN", "1e999", "1" * 400)


@pytest.mark.parametrize(
    "damage",
    [
        *("", "{", "[]", "[" * 100_000, '{"eta_m": 3}', json.dumps({"x\n" * 5000: {}})),
        *(json.dumps({"eta_m": SOUND | {"value": "V"}}).replace('"V"', value) for value in UNSOUND),
        *(json.dumps({"eta_m": SOUND | {name: "x"}}) for name in ("n", "low", "high", "worst", "worst_t_ns")),
        *(json.dumps({"eta_m": SOUND | wrong}) for wrong in ({"n": -1}, {"n": 1.5}, {"unit": 3})),
    ],
)
def test_damaged_metrics_are_one_short_line(tiny_run: Path, damage: str) -> None:
    (tiny_run / "metrics.json").write_text(damage)
    with pytest.raises(NotARun, match=r"metrics\.json: is damaged: [^\n]{1,200}$"):
        read_metrics(tiny_run)


def test_a_claimed_run_loses_nothing_until_it_is_begun(tiny_run: Path, left_part: str) -> None:
    (tiny_run / left_part).write_bytes(b"left by a kill")
    (tiny_run / "plots").mkdir()
    (tiny_run / "plots" / "ranges.png").write_bytes(b"")
    with pytest.raises(AlreadyExists):
        RunFolder.claim(tiny_run)
    before = {name: data for name, data in content(tiny_run).items() if name != left_part}
    folder = RunFolder.claim(tiny_run, replace=True)
    assert content(tiny_run) == before
    folder.begin({"planner": {"name": "astar"}}, keep=("poses.parquet", "stages.json"))
    assert sorted(content(tiny_run)) == ["config.toml", "poses.parquet"]
    assert not (tiny_run / "plots").exists()
    assert (tiny_run / "poses.parquet").read_bytes() == before["poses.parquet"]
    assert tomllib.loads((tiny_run / "config.toml").read_text()) == {"planner": {"name": "astar"}}


@pytest.mark.parametrize("dies_at", range(5))
def test_a_run_that_is_begun_and_killed_is_unfinished_and_still_quadlogs(
    tiny_run: Path, monkeypatch: pytest.MonkeyPatch, dies_at: int
) -> None:
    (tiny_run / "plots").mkdir()
    (tiny_run / "plots" / "ranges.png").touch()
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
    with pytest.raises(NotARun):
        read_record(tiny_run)
    RunFolder.claim(tiny_run, replace=True).begin({}, ())
    assert sorted(content(tiny_run)) == ["config.toml"]


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
