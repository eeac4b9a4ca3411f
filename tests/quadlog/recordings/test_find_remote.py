from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from quadlog.errors import RecordingNotFound
from quadlog.recordings.find import find_recordings


@pytest.fixture
def season(bucket: Any) -> str:
    for name in ("a.mcap", "b.bag", "deep/c.db3", "notes.txt", "../up.mcap", "deep/.hidden.mcap", "bag/bag_0.db3"):
        bucket.pipe_file(f"{bucket.name}/season/{name}", b"x")
    bucket.pipe_file(f"{bucket.name}/season/bag/bag_1.db3", b"x")
    bucket.pipe_file(f"{bucket.name}/season/run/derived.mcap", b"x")
    bucket.pipe_file(f"{bucket.name}/season/run/run.json", b'{"quadlog_version": "1"}')
    return f"s3://{bucket.name}/season"


def found(*arguments: str | Path) -> list[str]:
    return [str(path) for path in find_recordings(arguments)]


def test_folders_and_patterns_in_a_bucket(season: str) -> None:
    everything = [f"{season}/a.mcap", f"{season}/b.bag", f"{season}/bag", f"{season}/deep/c.db3"]
    assert found(season) == found(f"{season}/") == found(f"{season}/", f"{season}/a.mcap") == everything
    assert found(f"{season}/*.mcap") == [f"{season}/a.mcap"]
    assert found(f"{season}/[ab].*") == everything[:2]
    assert found(f"{season}/**/*.db3") == [f"{season}/bag/bag_0.db3", f"{season}/bag/bag_1.db3", f"{season}/deep/c.db3"]
    assert found(f"{season}/ba*") == [f"{season}/bag"]


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
    assert sorted(found(f"@{season}/list.txt")) == sorted(there)
    assert sorted(found(f"@{tmp_path}/list.txt")) == sorted(there[1:])


@pytest.mark.parametrize("line", ["/etc/passwd", "../up.mcap", "deep/../../other/x.mcap", "file:///etc/passwd"])
def test_a_remote_list_cannot_name_local_files(web: Any, tmp_path: Path, line: str) -> None:
    (web.folder / "list.txt").write_text(f"{line}\n")
    with pytest.raises(RecordingNotFound, match="names URLs or what lies beside it"):
        find_recordings([f"@{web.url}/list.txt"])
