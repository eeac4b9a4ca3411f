"""The same recording on this machine, behind a web server and in a bucket gives the same messages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import zstandard
from aiohttp import web as http

from quadlog.errors import StorageChanged, StorageFailed
from quadlog.recordings.containers.open import open_container
from quadlog.recordings.recording import open_recording
from quadlog.recordings.survey import indexed_times, rates_hz
from quadlog.storage.remote_object import BLOCK_BYTES
from quadlog.storage.remote_path import to_path
from tests.lab import recordings


@pytest.mark.parametrize("name", ["walk.mcap", "walk.bag", "walk.db3", "walk.mcap.zstd", "season.split"])
def test_messages_are_the_same_wherever_they_lie(web: Any, bucket: Any, name: str) -> None:
    path = recordings.build(name.split(".")[1], web.folder / name, recordings.some(80))
    if name.endswith(".zstd"):
        path.write_bytes(zstandard.compress(path.read_bytes()))
    for each in path.iterdir() if path.is_dir() else [path]:
        bucket.put_file(str(each), f"{bucket.name}/{each.relative_to(web.folder)}")
    with open_container(path) as container:
        expected = recordings.read(container)
    assert len(expected) == 80
    for url in (f"s3://{bucket.name}/{name}", *([] if path.is_dir() else [f"{web.url}/{name}"])):
        with open_recording(url) as recording:
            assert recordings.read(recording.container) == expected
            assert recordings.read(recording.container, ["/a"]) == [each for each in expected if each[0] == "/a"]
            assert (recording.losses, recording.warnings, str(recording.path)) == ([], [], url)


def test_a_damaged_file_is_recovered_as_on_this_machine(web: Any) -> None:
    path = recordings.mcap(web.folder / "walk.mcap", recordings.some(80))
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    with open_container(path) as local, open_container(to_path(f"{web.url}/walk.mcap")) as remote:
        assert recordings.read(remote) == recordings.read(local) != []
        assert remote.losses == local.losses != []


def test_a_server_without_ranges_is_copied_whole_with_a_warning(web: Any) -> None:
    path = recordings.mcap(web.folder / "walk.mcap", recordings.some(80))
    web.answer = lambda _: http.Response(body=path.read_bytes())
    with open_container(path) as local, open_container(to_path(f"{web.url}/walk.mcap")) as remote:
        assert recordings.read(remote) == recordings.read(local)
        (warning,) = remote.warnings
        assert warning == "the server does not serve byte ranges; the whole file was copied before it was read"


@pytest.mark.parametrize("status", [401, 404, 416, 503])
def test_a_server_that_fails_is_no_damage_of_the_recording(web: Any, status: int) -> None:
    """Losses would be reported, and the run be marked as done with loss."""
    path = build_large(web.folder / "walk.mcap")
    error = StorageChanged if status in (404, 416) else StorageFailed
    with open_container(to_path(f"{web.url}/{path.name}")) as container:
        web.answer = lambda _: http.Response(status=status)
        with pytest.raises(error):
            recordings.read(container)
        assert container.losses == []


@pytest.mark.parametrize("name", ["walk.mcap", "walk.bag"])
def test_a_recording_that_is_replaced_while_it_is_read_is_noticed_at_the_end(web: Any, name: str) -> None:
    """Whatever of it was read before: a whole one of the same size, in which every chunk is sound."""
    path = build_large(web.folder / name)
    with open_container(to_path(f"{web.url}/{name}")) as container:
        messages = container.messages()
        next(messages)
        path.write_bytes(path.read_bytes())
        with pytest.raises(StorageChanged):
            list(messages)
        with pytest.raises(StorageChanged):
            list(container.log_times())


def build_large(path: Path) -> Path:
    """Far more than one request brings when it is opened."""
    messages = recordings.some(20_000)
    if path.suffix == ".bag":
        return recordings.bag(path, messages, chunk_bytes=200_000)
    return recordings.mcap(path, messages, chunk_size=200_000)


@pytest.mark.parametrize("name", ["walk.mcap", "walk.bag"])
def test_log_times_cost_no_more_than_the_index(web: Any, name: str) -> None:
    """Not even the blocks around the message indexes, which would be most of the file."""
    path = build_large(web.folder / name)
    with open_container(path) as local, open_container(to_path(f"{web.url}/{name}")) as remote:
        here, there = (
            {channel.topic: (len(t_ns), rates_hz(t_ns)) for channel, t_ns in indexed_times(each).items()}
            for each in (local, remote)
        )
    assert here == there
    listed_bytes = 20_000 * 16
    assert web.sent_bytes < listed_bytes + 3 * BLOCK_BYTES
    assert web.sent_bytes < path.stat().st_size / 2
