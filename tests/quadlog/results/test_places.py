from __future__ import annotations

import json
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from quadlog.errors import AlreadyExists, CannotWrite, NotARun
from quadlog.results.find_runs import FAILED, OWN_FILES, find_runs
from quadlog.results.record import RunRecord, is_finished
from quadlog.results.run import check_place, create_run, finish_run, load_run, new_run, settle
from tests.lab.runs import begin_run


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}


def test_the_same_run_has_the_same_bytes(write_run: Callable[[Path], Path], tmp_path: Path) -> None:
    one, other = content(write_run(tmp_path / "a")), content(write_run(tmp_path / "b"))
    assert one == other
    of_some_logs = {"reference.tum", "joints.parquet", "other_poses.parquet", "body.parquet", "gait.parquet"}
    assert set(one) == OWN_FILES - {"report.html", "failed.json"} - of_some_logs


def test_a_run_is_unfinished_from_its_first_file_to_its_last(tmp_path: Path, tiny_record: RunRecord) -> None:
    run = begin_run(tmp_path / "walk", {"planner": {"name": "astar"}})
    assert json.loads((run.path / "run.json").read_text())["finished"] is False
    assert tomllib.loads((run.path / "config.toml").read_text())["planner"]["name"] == "astar"
    assert find_runs([tmp_path]) == [run.path]
    with pytest.raises(NotARun, match="is an unfinished run"):
        load_run(run.path)
    with pytest.raises(AlreadyExists, match=r"--force.*--resume"):
        check_place(run.path)
    check_place(run.path, replace=True)
    finish_run(run, tiny_record)
    assert load_run(run.path).record.model_dump(mode="json") == tiny_record.model_dump(mode="json")


@pytest.mark.parametrize("name", ["notes.md", "config.toml", "run.json", "map.pgm", "poses.parquet"])
@pytest.mark.parametrize("replace", [False, True])
def test_a_folder_of_something_else_is_never_touched(tmp_path: Path, name: str, replace: bool) -> None:
    (tmp_path / name).write_bytes(b'{"name": "not ours"}')
    (tmp_path / ".quadlog-1-0.part").write_bytes(b"")
    with pytest.raises(CannotWrite, match="holds other files and is no run of quadlog"):
        check_place(tmp_path, replace)
    assert sorted([each.name for each in tmp_path.iterdir()]) == sorted([".quadlog-1-0.part", name])
    with pytest.raises(CannotWrite, match=r"Not a directory|File exists"):
        new_run(tmp_path / name / "deeper").__enter__()


def replaced(run: Path, record: RunRecord) -> None:
    with new_run(run, force=True) as place:
        finish_run(create_run(place, record), record)


def test_a_run_stands_until_its_successor_is_whole_and_strangers_files_stay(
    tiny_run: Path, tmp_path: Path, tiny_record: RunRecord, left_part: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = ("failed.json", "plots/trajectory.png", f"plots/{left_part}")
    theirs = {"plots/mine.svg", "plots/photo.png", "notes.md", "mine/run.json"}
    for name in (*ours, *theirs):
        (tiny_run / name).parent.mkdir(exist_ok=True)
        (tiny_run / name).write_bytes(b"x")
    precious = tmp_path / "precious"
    precious.write_bytes(b"x")
    (tiny_run / "map.yaml").unlink()
    (tiny_run / "map.yaml").symlink_to(precious)
    before = content(tiny_run)
    with monkeypatch.context() as patch:
        patch.setitem(globals(), "finish_run", None)
        with pytest.raises(TypeError):
            replaced(tiny_run, tiny_record)
    assert content(tiny_run) == before
    replaced(tiny_run, tiny_record)
    left = {path.relative_to(tiny_run).as_posix() for path in tiny_run.rglob("*") if path.is_file()}
    assert left == theirs | {"run.json", "config.toml"}
    assert precious.exists()
    assert not (tiny_run.parent / ".stages").exists()
    (tmp_path / "link").symlink_to(tiny_run)
    with pytest.raises(CannotWrite, match="symbolic link"):
        replaced(tmp_path / "link", tiny_record)


@pytest.mark.parametrize("renames", range(3))
def test_a_kill_between_the_renames_is_put_right_at_the_next_start(
    tiny_run: Path, tiny_record: RunRecord, monkeypatch: pytest.MonkeyPatch, renames: int
) -> None:
    (tiny_run / "notes.md").write_bytes(b"mine")
    before, done, rename = content(tiny_run), [], Path.rename

    def killed(path: Path, target: Path) -> None:
        if len(done) == renames:
            raise KeyboardInterrupt
        done.append(path)
        rename(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", killed)
        with pytest.raises(KeyboardInterrupt):
            replaced(tiny_run, tiny_record)
    settle(tiny_run)
    whole = sorted(before) if renames < 2 else ["config.toml", "notes.md", "run.json"]
    assert (sorted(content(tiny_run)), is_finished(tiny_run)) == (whole, True)


def test_of_two_new_runs_of_one_place_the_first_stays_and_the_second_is_refused(
    tmp_path: Path, tiny_record: RunRecord
) -> None:
    """But for what a failure left there, which counts as absent."""
    (tmp_path / "walk").mkdir()
    (tmp_path / "walk" / FAILED).write_bytes(b"{}")
    first = tiny_record.model_copy(update={"seed": 1})

    def made(record: RunRecord, meanwhile: Callable[[], None] = lambda: None) -> None:
        with new_run(tmp_path / "walk") as place:
            finish_run(create_run(place, record), record)
            meanwhile()

    with pytest.raises(AlreadyExists, match="--force"):
        made(tiny_record, lambda: made(first))
    assert load_run(tmp_path / "walk").record.seed == 1
    assert [*content(tmp_path / "walk")] == ["config.toml", "run.json"]
    assert [each.name for each in tmp_path.iterdir()] == ["walk"]


def test_only_a_run_of_quadlog_is_put_in_place(tiny_run: Path, tiny_record: RunRecord) -> None:
    """Somebody's folder of that name stays where it is; without a new run the old one comes back."""
    old = tiny_run.parent / ".stages" / f"old-{tiny_run.name}"
    old.mkdir(parents=True)
    (old / "thesis.tex").write_text("mine")
    before = content(tiny_run)
    settle(tiny_run)
    with pytest.raises(CannotWrite, match=f"{old.name}: .*no run of quadlog; move it away"):
        replaced(tiny_run, tiny_record)
    assert (content(tiny_run), [*content(old)]) == (before, ["thesis.tex"])
    shutil.rmtree(old)
    tiny_run.rename(old)  # and what was to replace it is gone
    settle(tiny_run)
    assert (content(tiny_run), old.exists()) == (before, False)
