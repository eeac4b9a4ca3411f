"""Which recordings folders, patterns and lists name, here and in buckets."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

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


@pytest.fixture
def season(bucket: Any) -> str:
    for name in ("a.mcap", "b.bag", "deep/c.db3", "notes.txt", "../up.mcap", "deep/.hidden.mcap", "bag/bag_0.db3"):
        bucket.pipe_file(f"{bucket.name}/season/{name}", b"x")
    bucket.pipe_file(f"{bucket.name}/season/bag/bag_1.db3", b"x")
    bucket.pipe_file(f"{bucket.name}/season/run/derived.mcap", b"x")
    bucket.pipe_file(f"{bucket.name}/season/run/run.json", b'{"quadlog_version": "1"}')
    return f"s3://{bucket.name}/season"


def at(*arguments: str | Path) -> list[str]:
    return [str(path) for path in find_recordings(arguments)]


def test_folders_and_patterns_in_a_bucket(season: str) -> None:
    everything = [f"{season}/a.mcap", f"{season}/b.bag", f"{season}/bag", f"{season}/deep/c.db3"]
    assert at(season) == at(f"{season}/") == at(f"{season}/", f"{season}/a.mcap") == everything
    assert at(f"{season}/*.mcap") == [f"{season}/a.mcap"]
    assert at(f"{season}/[ab].*") == everything[:2]
    assert at(f"{season}/**/*.db3") == [f"{season}/bag/bag_0.db3", f"{season}/bag/bag_1.db3", f"{season}/deep/c.db3"]
    assert at(f"{season}/ba*") == [f"{season}/bag"]


@pytest.mark.parametrize("argument", ["", "gone.mcap", "*.gone", "gone/"])
def test_urls_without_recordings_are_refused(bucket: Any, argument: str) -> None:
    with pytest.raises(RecordingNotFound, match=bucket.name):
        find_recordings([f"s3://{bucket.name}/{argument}"])


def test_lists_may_lie_anywhere_and_name_urls(season: str, bucket: Any, web: Any, tmp_path: Path) -> None:
    (web.folder / "walk.mcap").touch()
    lines = f"a.mcap\n{season}/b.bag  # by its whole name\n{web.url}/walk.mcap?sig=SECRET\n\n# nothing\ndeep/*.db3\n"
    bucket.pipe_file(f"{bucket.name}/season/list.txt", lines.encode("utf-8-sig"))  # as editors of Windows do
    (tmp_path / "list.txt").write_text(lines.replace("\na.mcap", "").replace("deep/", f"{season}/deep/")[7:])
    there = [f"{season}/a.mcap", f"{season}/b.bag", f"{season}/deep/c.db3", f"{web.url}/walk.mcap?..."]
    assert sorted(at(f"@{season}/list.txt")) == sorted(there)
    assert sorted(at(f"@{tmp_path}/list.txt")) == sorted(there[1:])


@pytest.mark.parametrize("line", ["/etc/passwd", "../up.mcap", "deep/../../other/x.mcap", "file:///etc/passwd"])
def test_a_remote_list_cannot_name_local_files(web: Any, tmp_path: Path, line: str) -> None:
    (web.folder / "list.txt").write_text(f"{line}\n")
    with pytest.raises(RecordingNotFound, match="names URLs or what lies beside it"):
        find_recordings([f"@{web.url}/list.txt"])
