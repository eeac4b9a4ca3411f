from __future__ import annotations

import pickle
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import StorageFailed
from quadlog.storage.remote_path import RemotePath, to_path
from quadlog.storage.urls import redacted, redacted_text

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
