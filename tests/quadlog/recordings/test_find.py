from __future__ import annotations

import pytest

from quadlog.errors import RecordingNotFound
from quadlog.recordings.find import find_recordings


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
    ):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    return tmp_path


def names(tree, found):
    return [str(path.relative_to(tree)) for path in found]


EVERYTHING = ["crossed_14_05.mcap", "deep/er/four.bag.active", "one.mcap", "split", "three.db3", "two.bag"]


def test_a_folder_is_searched_and_a_split_is_one_recording(tree):
    assert names(tree, find_recordings([tree])) == EVERYTHING


def test_nothing_comes_twice_and_order_does_not_depend_on_arguments(tree):
    twice = [tree / "two.bag", tree, str(tree / "one.mcap"), tree / "deep" / ".." / "two.bag"]
    assert len(find_recordings(twice)) == len(EVERYTHING)
    assert find_recordings([tree / "two.bag", tree / "one.mcap"]) == [tree / "one.mcap", tree / "two.bag"]


def test_a_file_named_outright_is_taken_whatever_its_name(tree):
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


def test_a_list_names_many_beside_itself_or_from_the_working_folder(tree, monkeypatch):
    monkeypatch.chdir(tree / "deep")
    (tree / "list.txt").write_text("# two runs\none.mcap\n\n../two.bag   # from here\nsplit\nthree.*\n")
    found = find_recordings([f"@{tree / 'list.txt'}"])
    assert {path.resolve().name for path in found} == {"one.mcap", "two.bag", "split", "three.db3"}


@pytest.mark.parametrize("argument", ["none.mcap", "@none.txt", "deep/nothing", "x" * 5000, "@list.txt", "@one.mcap"])
def test_what_leads_nowhere_is_named(tree, monkeypatch, argument):
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
