from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

from quadlog.errors import CannotWrite, FileError, StorageChanged, StorageFailed, TooLarge
from quadlog.storage import remote_path
from quadlog.storage.remote_object import RemoteBytes
from quadlog.storage.remote_path import RemotePath, copy_object

CONTENT = random.Random(5).randbytes(100_000)


def at(bucket: Any, name: str) -> RemotePath:
    return RemotePath(f"s3://{bucket.name}/{name}")


def test_files_and_folders_of_a_bucket(bucket: Any) -> None:
    for name in ("season/walk.mcap", "season/deep/other.mcap", "season/list.txt"):
        bucket.pipe_file(f"{bucket.name}/{name}", CONTENT)
    season = at(bucket, "season/")
    assert season.is_dir()
    assert not season.is_file()
    assert [(each.name, each.is_dir()) for each in season.iterdir()] == [
        ("deep", True),
        ("list.txt", False),
        ("walk.mcap", False),
    ]
    walk = season / "walk.mcap"
    assert (walk.is_file(), walk.stat().st_size, walk.read_bytes()) == (True, len(CONTENT), CONTENT)
    assert not (season / "gone").exists()
    assert [each.url for each in at(bucket, "season/*.mcap").matches()] == [walk.url]
    assert {each.name for each in at(bucket, "**/*.mcap").matches()} == {"walk.mcap", "other.mcap"}


def test_a_file_appears_whole_and_goes(bucket: Any, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(CONTENT)
    target = at(bucket, "runs/walk/file")
    at(bucket, "runs/walk").upload_all(tmp_path, ["file"])
    assert target.read_bytes() == CONTENT
    target.unlink()
    assert not target.exists()
    target.unlink()
    with pytest.raises(CannotWrite, match="nobucket"):
        RemotePath("s3://nobucket-of-ours/x").upload_all(tmp_path, ["file"])


def test_an_object_that_was_replaced_is_no_longer_read(bucket: Any) -> None:
    path = at(bucket, "walk.mcap")
    bucket.pipe_file(f"{bucket.name}/walk.mcap", CONTENT)
    remote = RemoteBytes(path.url, path.info())
    assert remote.read(10, 10) == CONTENT[10:20]
    remote.check_unchanged()
    bucket.pipe_file(f"{bucket.name}/walk.mcap", CONTENT[::-1])
    with pytest.raises(StorageChanged):
        remote.check_unchanged()


def test_copies_are_whole_and_bounded(bucket: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bucket.pipe_file(f"{bucket.name}/walk.mcap", CONTENT)
    path = at(bucket, "walk.mcap")
    copy_object(path, tmp_path / "copy.mcap")
    assert (tmp_path / "copy.mcap").read_bytes() == CONTENT
    monkeypatch.setattr(remote_path.shutil, "disk_usage", lambda _: type("Free", (), {"free": 150_000}))
    with pytest.raises(TooLarge):
        copy_object(path, tmp_path / "copy")
    assert not (tmp_path / "copy").exists()
    monkeypatch.setattr(remote_path, "MAX_WHOLE_BYTES", 99_999)
    with pytest.raises(TooLarge):
        path.read_bytes()


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("xyz://a/b", "xyz:// is not a protocol that quadlog reads"),
        ("github://a/b", "github:// is not a protocol that quadlog reads"),
        ("gs://a/b", "gcsfs"),
        ("s3://bucket-that-nobody-made/x", ""),
    ],
)
def test_unknown_protocols_and_missing_buckets(bucket: Any, url: str, words: str) -> None:
    if not words:
        assert not RemotePath(url).exists()
        return
    with pytest.raises(FileError, match=words):
        RemotePath(url).exists()


def test_a_web_server_has_no_folders_and_takes_nothing(web: Any, tmp_path: Path) -> None:
    top = RemotePath(f"{web.url}/")
    for ask in (top.exists, lambda: list(top.iterdir())):
        with pytest.raises(StorageFailed, match="cannot be listed"):
            ask()
    with pytest.raises(CannotWrite, match="takes no files"):
        (top / "x").upload_all(tmp_path, ["y"])
