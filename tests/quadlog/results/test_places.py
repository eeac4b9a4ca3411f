from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from quadlog.errors import AlreadyExists, CannotWrite, NotARun
from quadlog.results.find_runs import OWN_FILES, find_runs
from quadlog.results.places import claim, discard_if_empty, whole_run
from quadlog.results.record import RunRecord, is_finished
from quadlog.results.run import Run, load_run
from quadlog.storage.atomic_write import complete_folders, part_prefix
from tests.lab.runs import begin_run


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}


def test_the_same_run_has_the_same_bytes(write_run: Callable[[Path], Path], tmp_path: Path) -> None:
    one, other = content(write_run(tmp_path / "a")), content(write_run(tmp_path / "b"))
    assert one == other
    of_some_logs = {"reference.tum", "joints.parquet", "other_poses.parquet", "body.parquet", "gait.parquet"}
    assert set(one) == OWN_FILES - {"report.html", "stages.json"} - of_some_logs


def test_a_run_is_unfinished_from_its_first_file_to_its_last(tmp_path: Path, tiny_record: RunRecord) -> None:
    run = begin_run(tmp_path / "walk", {"planner": {"name": "astar"}})
    assert json.loads((run.path / "run.json").read_text())["finished"] is False
    assert tomllib.loads((run.path / "config.toml").read_text())["planner"]["name"] == "astar"
    assert find_runs([tmp_path]) == [run.path]
    assert run.path not in complete_folders(0.0)
    with pytest.raises(NotARun, match="is no finished run"):
        load_run(run.path)
    with pytest.raises(AlreadyExists):
        claim(run.path)
    run.finish(tiny_record)
    assert load_run(run.path).record.to_dict() == tiny_record.to_dict()
    assert complete_folders(0.0)[-1] == run.path


def test_an_existing_run_needs_a_flag_and_loses_nothing_until_the_new_one_begins(
    tiny_run: Path, tiny_record: RunRecord, left_part: str
) -> None:
    (tiny_run / left_part).write_bytes(b"left by a kill")
    before = {name: data for name, data in content(tiny_run).items() if name != left_part}
    with pytest.raises(AlreadyExists, match=r"--force.*--resume"):
        claim(tiny_run)
    claim(tiny_run, replace=True)
    assert content(tiny_run) == before
    Run.create(tiny_run, tiny_record, keep=("poses.parquet", "stages.json"))
    assert sorted(content(tiny_run)) == ["config.toml", "poses.parquet", "run.json"]
    assert not is_finished(tiny_run)


def test_what_is_removed_is_ours_and_nothing_behind_a_link(
    tiny_run: Path, tmp_path: Path, tiny_record: RunRecord, left_part: str
) -> None:
    for name in ("plots/ranges.png", f"plots/{left_part}", "plots/mine.svg", "notes.md", "mine/run.json"):
        (tiny_run / name).parent.mkdir(exist_ok=True)
        (tiny_run / name).write_bytes(b"x")
    precious = tmp_path / "precious"
    precious.write_bytes(b"x")
    (tiny_run / "map.yaml").unlink()
    (tiny_run / "map.yaml").symlink_to(precious)
    claim(tiny_run, replace=True)
    Run.create(tiny_run, tiny_record)
    left = {path.relative_to(tiny_run).as_posix() for path in tiny_run.rglob("*") if path.is_file()}
    assert left == {"plots/mine.svg", "notes.md", "mine/run.json", "run.json", "config.toml"}
    assert precious.exists()
    (tmp_path / "link").symlink_to(tiny_run)
    with pytest.raises(CannotWrite, match="symbolic link"):
        claim(tmp_path / "link", replace=True)


@pytest.mark.parametrize("name", ["notes.md", "config.toml", "run.json", "map.pgm", "poses.parquet"])
@pytest.mark.parametrize("replace", [False, True])
def test_a_folder_of_something_else_is_never_touched(tmp_path: Path, name: str, replace: bool) -> None:
    (tmp_path / name).write_bytes(b'{"name": "not ours"}')
    (tmp_path / ".quadlog-1-0.part").write_bytes(b"")
    with pytest.raises(CannotWrite, match="holds other files and is no run of quadlog"):
        claim(tmp_path, replace)
    assert sorted([each.name for each in tmp_path.iterdir()]) == sorted([".quadlog-1-0.part", name])
    with pytest.raises(CannotWrite, match="Not a directory"):
        claim(tmp_path / name / "deeper")


def test_a_run_of_another_format_can_be_replaced(tiny_run: Path) -> None:
    (tiny_run / "run.json").write_text('{"run_format": 2, "quadlog_version": "9"}')
    with pytest.raises(AlreadyExists):
        claim(tiny_run)
    claim(tiny_run, replace=True)


def test_a_run_that_is_begun_and_killed_is_unfinished_and_still_quadlogs(
    tiny_run: Path, tiny_record: RunRecord, monkeypatch: pytest.MonkeyPatch
) -> None:
    def dying_unlink(path: Path, missing_ok: bool = False) -> None:
        raise KeyboardInterrupt

    claim(tiny_run, replace=True)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", dying_unlink)
        with pytest.raises(KeyboardInterrupt):
            Run.create(tiny_run, tiny_record)
    assert not is_finished(tiny_run)
    claim(tiny_run, replace=True)


def test_a_run_without_results_is_taken_away_but_not_beside_what_another_writes(tmp_path: Path) -> None:
    discard_if_empty(tmp_path / "gone")
    run = begin_run(tmp_path / "run").path
    part = run / f"{part_prefix(os.getpid())}00000000.part"
    part.write_bytes(b"")
    discard_if_empty(run)
    assert part.exists()
    part.unlink()
    discard_if_empty(run)
    assert not run.exists()


def test_a_finished_run_stands_until_its_successor_is_whole(tiny_run: Path, tiny_record: RunRecord) -> None:
    before = content(tiny_run)
    (tiny_run / "notes.md").write_bytes(b"mine")

    def interrupted() -> None:
        with whole_run(tiny_run, force=True) as place:
            Run.create(place, tiny_record)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert content(tiny_run) == before | {"notes.md": b"mine"}
    with whole_run(tiny_run, force=True) as place:
        Run.create(place, tiny_record).finish(tiny_record)
    assert sorted(content(tiny_run)) == ["config.toml", "notes.md", "run.json"]
    assert is_finished(tiny_run)
    assert [each.name for each in tiny_run.parent.iterdir()] == [tiny_run.name]
