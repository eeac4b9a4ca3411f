from __future__ import annotations

import os
from pathlib import Path

import pytest

from quadlog.errors import NotARecording, RecordingNotFound, TooLarge
from quadlog.recordings.find import find_recordings
from tests.lab.runs import begin_run


@pytest.fixture
def tree(tmp_path):
    for name in (
        "one.mcap",
        "two.bag",
        "three.db3",
        "notes.txt",
        ".hidden.mcap",
        "deep/er/four.bag.active",
        ".git/five.mcap",
        "split/split_0.mcap",
        "split/split_1.mcap",
        "crossed_14_05.mcap",
        "packed.mcap.zst",
    ):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    return tmp_path


def names(tree, found):
    return [str(path.relative_to(tree)) for path in found]


EVERYTHING = [
    "crossed_14_05.mcap",
    "deep/er/four.bag.active",
    "one.mcap",
    "packed.mcap.zst",
    "split",
    "three.db3",
    "two.bag",
]


def test_a_folder_is_searched_and_a_split_is_one_recording(tree):
    assert names(tree, find_recordings([tree])) == EVERYTHING


def test_nothing_comes_twice_and_order_does_not_depend_on_arguments(tree):
    twice = [tree / "two.bag", tree, str(tree / "one.mcap"), tree / "deep" / ".." / "two.bag"]
    assert len(find_recordings(twice)) == len(EVERYTHING)
    assert find_recordings([tree / "two.bag", tree / "one.mcap"]) == [tree / "one.mcap", tree / "two.bag"]
    # A file that is named is taken, whatever its name.
    assert names(tree, find_recordings([tree / "notes.txt", tree / ".hidden.mcap"])) == [".hidden.mcap", "notes.txt"]


def test_patterns(tree):
    assert names(tree, find_recordings([f"{tree}/*.mcap", f"{tree}/**/*.active"])) == [
        "crossed_14_05.mcap",
        "deep/er/four.bag.active",
        "one.mcap",
    ]
    assert names(tree, find_recordings([f"{tree}/*"])) == EVERYTHING
    with pytest.raises(RecordingNotFound, match="pattern"):
        find_recordings([f"{tree}/*.txt"])


@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_a_list_names_many_beside_itself_or_from_the_working_folder(tree, monkeypatch, mark):
    """It may begin with a byte order mark, before a comment or a name."""
    monkeypatch.chdir(tree / "deep")
    for first in ("# two runs\r\n", ""):
        text = f"{mark}{first}one.mcap\r\n\n../two.bag   # from here\nsplit\nthree.*\n"
        (tree / "list.txt").write_text(text, "utf-8")
        found = find_recordings([f"@{tree / 'list.txt'}"])
        assert {path.resolve().name for path in found} == {"one.mcap", "two.bag", "split", "three.db3"}


@pytest.mark.parametrize("argument", ["none.mcap", "@none.txt", "deep/nothing", "x" * 5000, "@list.txt", "@one.mcap"])
def test_arguments_without_recordings_are_refused(tree, monkeypatch, argument):
    monkeypatch.chdir(tree)
    (tree / "deep" / "nothing").mkdir()
    (tree / "list.txt").write_text("# nothing\n")
    (tree / "one.mcap").write_bytes(b"\xff\xfe")
    with pytest.raises(RecordingNotFound):
        find_recordings([argument])


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        (["run_0.mcap"], 1),
        (["run_1.mcap", "run_2.mcap"], 1),
        (["run_7.mcap"], 0),
        (["run_14_05.mcap", "run_14_55.mcap"], 0),
        (["run_0.mcap", "walk_1.mcap"], 0),
        (["run_0.mcap", "run_1.db3"], 0),
        (["run_00.mcap", "run_01.mcap"], 0),
    ],
)
def test_which_folders_are_one_recording(tmp_path, files, expected):
    for name in files:
        (tmp_path / name).write_bytes(b"x")
    found = find_recordings([tmp_path])
    assert (found == [tmp_path]) == bool(expected)
    if not expected:
        assert len(found) == len(files)


@pytest.fixture
def run(tree):
    folder = begin_run(tree / "runs" / "one")
    (folder.path / "derived.mcap").write_bytes(b"x")
    return folder.path


def test_results_of_a_replay_are_not_replayed(tree, run):
    assert names(tree, find_recordings([tree])) == EVERYTHING
    patterns = ["*", "**/*.mcap", "*.bag", "*.db3", "**/*.active"]
    assert "runs/one/derived.mcap" not in names(tree, find_recordings([f"{tree}/{each}" for each in patterns]))
    with pytest.raises(RecordingNotFound, match="a run folder of quadlog"):
        find_recordings([run])
    assert find_recordings([run / "derived.mcap"]) == [run / "derived.mcap"]
    (run / "config.toml").unlink()
    (run / "run.json").write_text('{"command": [], "quadlog_version": "1"}')
    assert names(tree, find_recordings([tree])) == EVERYTHING


def test_recordings_beside_files_of_those_names_are_found(tree, run):
    (tree / "config.toml").write_bytes((run / "config.toml").read_bytes())
    (tree / "deep" / "run.json").write_text('{"operator": "me"}')
    (tree / "deep" / "derived.mcap").write_bytes(b"x")
    found = names(tree, find_recordings([tree]))
    assert set(found) == {*EVERYTHING, "deep/derived.mcap"}


def test_linked_folders_are_searched_once(tree, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("disk")
    (elsewhere / "far.mcap").write_bytes(b"x")
    (elsewhere / "loop").symlink_to(elsewhere)
    (elsewhere / "split").mkdir()
    (elsewhere / "split" / "s_0.mcap").write_bytes(b"x")
    (tree / "linked").symlink_to(elsewhere)
    (tree / "linked_again").symlink_to(elsewhere)
    found = [path.resolve() for path in find_recordings([tree])]
    assert [path for path in found if path.is_relative_to(elsewhere)] == [elsewhere / "far.mcap", elsewhere / "split"]
    assert len(found) == len(EVERYTHING) + 2


def test_a_folder_that_cannot_be_read_is_named(tree, monkeypatch):
    """Even the administrator, whom permissions do not stop, must see it: so the refusal is played."""
    closed = tree / "deep" / "er"
    really = Path.iterdir

    def iterdir(folder):
        if folder == closed:
            raise PermissionError(13, "Permission denied", str(folder))
        return really(folder)

    monkeypatch.setattr(Path, "iterdir", iterdir)
    with pytest.raises(RecordingNotFound, match="deep/er: Permission denied"):
        find_recordings([tree])


def test_pipes_and_devices_are_refused_at_once(tree):
    os.mkfifo(tree / "pipe.mcap")
    for path in (tree / "pipe.mcap", Path(os.devnull)):
        with pytest.raises(NotARecording, match="not a regular file"):
            find_recordings([path])
    assert names(tree, find_recordings([f"{tree}/*.mcap"])) == ["crossed_14_05.mcap", "one.mcap"]


def test_a_recording_given_as_a_list_is_not_read_as_text(tree):
    with (tree / "large.mcap").open("wb") as file:
        file.truncate(1 << 30)
    with pytest.raises(TooLarge):
        find_recordings([f"@{tree / 'large.mcap'}"])
