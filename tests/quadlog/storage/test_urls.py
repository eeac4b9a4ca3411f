from __future__ import annotations

import pickle
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import StorageUnknown
from quadlog.storage.remote_path import RemotePath
from quadlog.storage.urls import is_url, redacted, redacted_text, to_path

LETTERS = st.characters(codec="ascii", categories=("L", "N"))
SECRET = st.text(LETTERS, min_size=6, max_size=20).map("Q{}Q".format)
PLACES = st.sampled_from(["https://host/a/walk.mcap", "http://host:80/walk", "s3://lab/season/walk.mcap", "sftp://h/x"])


@given(PLACES, SECRET, SECRET)
def test_what_is_shown_of_a_url_has_neither_its_query_nor_its_user(place: str, query: str, user: str) -> None:
    protocol, _, rest = place.partition("://")
    url = f"{protocol}://{user}:{user}@{rest}?X-Signature={query}"
    path = to_path(url)
    shown = [redacted(url), str(path), repr(path), f"{path}: gone", redacted_text(f"quadlog replay {url} -o runs")]
    assert all(query not in each and user not in each for each in shown)
    assert all(rest in each for each in shown)
    assert path.name == place.rpartition("/")[2]
    assert isinstance(path, RemotePath)
    assert path.url == url


@given(st.text())
def test_no_text_is_more_than_an_error(text: str) -> None:
    try:
        path = to_path(text)
    except StorageUnknown:
        assert is_url(text)
    else:
        assert isinstance(path, Path | RemotePath)
        assert isinstance(path, RemotePath) <= is_url(text)


@pytest.mark.parametrize(
    ("text", "path"),
    [
        ("runs/x", Path("runs/x")),
        ("file:///data/my%20walk.mcap", Path("/data/my walk.mcap")),
        ("file://localhost/data/x", Path("/data/x")),
        ("FILE:///data/x", Path("/data/x")),
    ],
)
def test_what_lies_on_this_machine_is_a_path(text: str, path: Path) -> None:
    assert to_path(text) == path


BAD_FILES = ["file://other/x", "file://[x", "file://\u2100/x", "file:///a%00b"]


@pytest.mark.parametrize("text", [*BAD_FILES, "://x", "s3://", "1a://b", "a b://c"])
def test_what_is_no_url_is_told(text: str) -> None:
    with pytest.raises(StorageUnknown):
        to_path(text)


def test_parts_of_a_url() -> None:
    path = RemotePath("https://host/season/walk_3.mcap?sig=1")
    assert (path.name, path.stem, path.suffix) == ("walk_3.mcap", "walk_3", ".mcap")
    assert path.parent.url == "https://host/season"
    assert path.with_name("list.txt").url == "https://host/season/list.txt"
    assert (path / "below").url == "https://host/season/walk_3.mcap/below"
    assert RemotePath("s3://lab").parent.url == "s3://lab"


def test_urls_are_sorted_behind_paths_and_keep_their_secret_on_the_way_to_another_process() -> None:
    places = [RemotePath("s3://b/2"), Path("z"), RemotePath("s3://b/1?versionId=3"), Path("a")]
    assert sorted(places) == [places[3], places[1], places[2], places[0]]
    assert pickle.loads(pickle.dumps(places[2])) == places[2]
    assert len({places[0], RemotePath("s3://b/2")}) == 1
