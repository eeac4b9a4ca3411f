"""Paths behind URLs: files and folders of a bucket, and what is shown of a URL."""

from __future__ import annotations

import pickle
import random
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import CannotWrite, FileError, StorageChanged, StorageFailed, TooLarge
from quadlog.storage import remote_path
from quadlog.storage.remote_object import RemoteBytes
from quadlog.storage.remote_path import RemotePath, copy_object, to_path
from quadlog.storage.urls import redacted, redacted_text

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


LETTERS = st.characters(codec="ascii", categories=("L", "N"))
SECRET = st.text(LETTERS, min_size=6, max_size=20).map("Q{}Q".format)
PLACES = st.sampled_from(["https://host/a/walk.mcap", "http://host:80/walk", "s3://lab/season/walk.mcap", "sftp://h/x"])


@given(PLACES, SECRET, SECRET, st.sampled_from(["", "/Q", "+/Q="]))
def test_a_redacted_url_has_neither_query_nor_user(place: str, query: str, user: str, end: str) -> None:
    """Keys and signatures are base64, so they hold slashes that users do not escape."""
    protocol, _, rest = place.partition("://")
    url = f"{protocol}://{user}:{user}{end}@{rest}?v=1&X-Signature={query}{end}&w=/{query}"
    path = to_path(url)
    shown = [redacted(url), str(path), repr(path), f"{path}: gone", redacted_text(f"quadlog replay {url} -o runs")]
    assert all(query not in each and user not in each for each in shown)
    assert all(rest in each for each in shown)
    assert path.name == place.rpartition("/")[2]
    assert isinstance(path, RemotePath)
    assert path.url == url


@pytest.mark.parametrize(
    ("url", "shown", "name"),
    [
        ("s3://key:se/cret@bucket", "s3://bucket", "bucket"),
        ("s3://key:secret@bucket", "s3://bucket", "bucket"),
        ("abfs://c/a.mcap?sv=1&sig=ab/cd=", "abfs://c/a.mcap?...", "a.mcap"),
        ("s3://lab/person@home/a?b.mcap", "s3://lab/person@home/a?b.mcap", "a?b.mcap"),
        ("http://host:80/person@home/x", "http://host:80/person@home/x", "x"),
    ],
)
def test_redacted_urls_and_names(url: str, shown: str, name: str) -> None:
    assert (redacted(url), RemotePath(url).name) == (shown, name)


@pytest.mark.parametrize(
    "url", ["s3://KEYKEY:se/cret@bucket", "s3://KEYKEY:secret@bucket/a.mcap", "http://KEYKEY:se/cret@h/a"]
)
def test_secrets_in_library_errors_are_removed(url: str) -> None:
    with pytest.raises(StorageFailed) as raised:
        RemotePath(url).exists()
    assert not {"KEYKEY", "se", "cret", "secret"} & set(re.findall(r"\w+", str(raised.value)))


def test_urls_are_sorted_behind_paths_and_keep_their_secret_on_the_way_to_another_process() -> None:
    places = [RemotePath("s3://b/2"), Path("z"), RemotePath("s3://b/1?versionId=3"), Path("a")]
    assert sorted(places) == [places[3], places[1], places[2], places[0]]
    assert pickle.loads(pickle.dumps(places[2])) == places[2]
    assert len({places[0], RemotePath("s3://b/2")}) == 1
