from __future__ import annotations

import os
from pathlib import Path

import pytest

from quadlog.errors import NotARecording, RecordingNotFound, TooLarge
from quadlog.recordings.find import find_recordings
from tests.lab.runs import begin_run

FILES = ("one.mcap", "two.bag", "three.db3", "notes.txt", ".hidden.mcap", "deep/er/four.bag.active", ".git/five.mcap")
FILES += ("split/split_0.mcap", "split/split_1.mcap", "crossed_14_05.mcap", "packed.mcap.zst")
EVERYTHING = ["crossed_14_05.mcap", "deep/er/four.bag.active", "one.mcap", "packed.mcap.zst", "split"]
EVERYTHING += ["three.db3", "two.bag"]


@pytest.fixture
def tree(tmp_path):
    for name in FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"x")
    return tmp_path


def found(tree, *arguments):
    return [str(path.relative_to(tree)) for path in find_recordings([f"{tree}/{each}" for each in arguments])]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([""], EVERYTHING),
        (["two.bag", "", "one.mcap", "deep/../two.bag"], EVERYTHING),  # nothing comes twice
        (["two.bag", "one.mcap"], ["one.mcap", "two.bag"]),
        (["notes.txt", ".hidden.mcap"], [".hidden.mcap", "notes.txt"]),  # a file that is named is taken
        (["*.mcap", "**/*.active"], ["crossed_14_05.mcap", "deep/er/four.bag.active", "one.mcap"]),
        (["*"], EVERYTHING),
    ],
)
def test_folders_files_and_patterns(tree, arguments, expected):
    assert found(tree, *arguments) == expected


def test_a_list_names_many_beside_itself_or_from_the_working_folder(tree, monkeypatch):
    monkeypatch.chdir(tree / "deep")
    text = "\ufeffone.mcap\r\n\n../two.bag   # from here\nsplit\nthree.*\n"
    (tree / "list.txt").write_text(text, "utf-8")
    listed = find_recordings([f"@{tree / 'list.txt'}"])
    assert {path.resolve().name for path in listed} == {"one.mcap", "two.bag", "split", "three.db3"}


@pytest.mark.parametrize(
    "argument", ["none.mcap", "*.txt", "@none.txt", "deep/nothing", "x" * 5000, "@list.txt", "@one.mcap"]
)
def test_arguments_without_recordings_are_refused(tree, monkeypatch, argument):
    monkeypatch.chdir(tree)
    (tree / "deep" / "nothing").mkdir()
    (tree / "list.txt").write_text("# nothing\n")
    (tree / "one.mcap").write_bytes(b"\xff\xfe")
    with pytest.raises(RecordingNotFound):
        find_recordings([argument])


@pytest.mark.parametrize(
    ("files", "is_one"),
    [
        (["run_0.mcap"], True),
        (["run_1.mcap", "run_2.mcap"], True),
        (["run_7.mcap"], False),
        (["run_14_05.mcap", "run_14_55.mcap"], False),
        (["run_0.mcap", "walk_1.mcap"], False),
        (["run_0.mcap", "run_1.db3"], False),
        (["run_00.mcap", "run_01.mcap"], False),
    ],
)
def test_which_folders_are_one_recording(tmp_path, files, is_one):
    for name in files:
        (tmp_path / name).write_bytes(b"x")
    assert find_recordings([tmp_path]) == ([tmp_path] if is_one else [tmp_path / name for name in files])


def test_results_of_a_replay_are_not_replayed(tree):
    """Unless they are named; a file of that name elsewhere is a recording."""
    run = begin_run(tree / "runs" / "one").path
    for folder in (run, tree / "deep"):
        (folder / "derived.mcap").write_bytes(b"x")
    (tree / "deep" / "run.json").write_text('{"operator": "me"}')
    expected = sorted([*EVERYTHING, "deep/derived.mcap"])
    assert found(tree, "") == expected
    assert "runs/one/derived.mcap" not in found(tree, "**/*.mcap")
    with pytest.raises(RecordingNotFound):
        find_recordings([run])
    assert find_recordings([run / "derived.mcap"]) == [run / "derived.mcap"]
    (run / "config.toml").unlink()
    assert found(tree, "") == expected


def test_linked_folders_are_searched_once(tree, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("disk")
    (elsewhere / "far.mcap").write_bytes(b"x")
    for link in (elsewhere / "loop", tree / "linked", tree / "linked_again"):
        link.symlink_to(elsewhere)
    assert len(find_recordings([tree])) == len(EVERYTHING) + 1


def test_what_cannot_be_read_is_named(tree, monkeypatch):
    """Even the administrator, whom permissions do not stop, must see it: so the refusal is played."""
    os.mkfifo(tree / "pipe.mcap")
    with pytest.raises(NotARecording):
        find_recordings([tree / "pipe.mcap"])
    with (tree / "large.mcap").open("wb") as file:
        file.truncate(1 << 30)
    with pytest.raises(TooLarge):
        find_recordings([f"@{tree / 'large.mcap'}"])
    closed, really = tree / "deep" / "er", Path.iterdir

    def iterdir(folder):
        if folder == closed:
            raise PermissionError(13, "Permission denied", str(folder))
        return really(folder)

    monkeypatch.setattr(Path, "iterdir", iterdir)
    with pytest.raises(RecordingNotFound, match="deep/er"):
        find_recordings([tree])
