"""The same recording on this machine, behind a web server and in a bucket gives the same messages."""

from __future__ import annotations

import errno
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import aiohttp
import pytest
import zstandard
from aiohttp import web as http

from quadlog.errors import NotARecording, RecordingNotFound, StorageChanged, StorageFailed
from quadlog.recordings.containers.open import open_container
from quadlog.recordings.recording import open_recording
from quadlog.recordings.survey import indexed_pulses
from quadlog.storage import remote_object as web_object
from quadlog.storage.byte_ranges import BLOCK_BYTES
from quadlog.storage.remote_path import to_path


@pytest.fixture(autouse=True)
def _no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web_object, "_WAITS_S", (0.0,))


@pytest.mark.parametrize("name", ["walk.mcap", "walk.bag", "walk.db3", "walk.mcap.zstd", "season.split"])
def test_messages_are_the_same_wherever_they_lie(recordings: Any, web: Any, bucket: Any, name: str) -> None:
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


def test_two_passes_transfer_a_file_once(recordings: Any, web: Any) -> None:
    path = recordings.mcap(web.folder / "walk.mcap", recordings.some(20_000), chunk_size=200_000)
    with open_container(to_path(f"{web.url}/walk.mcap")) as container:
        recordings.read(container)
        recordings.read(container)
    assert path.stat().st_size > 10 * 65536
    assert web.sent_bytes <= path.stat().st_size + 2


def test_a_damaged_file_is_recovered_as_on_this_machine(recordings: Any, web: Any) -> None:
    path = recordings.mcap(web.folder / "walk.mcap", recordings.some(80))
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    with open_container(path) as local, open_container(to_path(f"{web.url}/walk.mcap")) as remote:
        assert recordings.read(remote) == recordings.read(local) != []
        assert remote.losses == local.losses != []


def test_a_server_without_ranges_is_copied_whole_with_a_warning(recordings: Any, web: Any) -> None:
    path = recordings.mcap(web.folder / "walk.mcap", recordings.some(80))
    web.answer = lambda _: http.Response(body=path.read_bytes())
    with open_container(path) as local, open_container(to_path(f"{web.url}/walk.mcap")) as remote:
        assert recordings.read(remote) == recordings.read(local)
        (warning,) = remote.warnings
        assert warning == "the server does not serve byte ranges; the whole file was copied before it was read"


@pytest.mark.parametrize("name", ["walk.mcap", "walk.bag"])
@pytest.mark.parametrize("status", [401, 404, 412, 416, 503])
def test_a_server_that_fails_is_no_damage_of_the_recording(recordings: Any, web: Any, status: int, name: str) -> None:
    """Losses would be reported, and the run be marked as done with loss."""
    path = build_large(recordings, web.folder / name)
    error = StorageChanged if status in (404, 410, 412) else StorageFailed
    with open_container(to_path(f"{web.url}/{path.name}")) as container:
        web.answer = lambda _: http.Response(status=status)
        with pytest.raises(error):
            recordings.read(container)
        assert container.losses == []


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.EIO, "Input/output error"),
        FileNotFoundError("gone"),
        PermissionError("no"),
        TimeoutError(),
        EOFError(),
        aiohttp.ServerDisconnectedError(),
        aiohttp.ClientConnectorDNSError(SimpleNamespace(host="h", port=1, ssl=True), OSError(0, "")),
    ],
    ids=lambda error: type(error).__name__,
)
def test_no_failure_of_a_connection_is_damage_of_the_recording(
    recordings: Any, web: Any, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    async def failing(*_: Any) -> None:
        raise error

    path = build_large(recordings, web.folder / "walk.mcap")
    with open_container(to_path(f"{web.url}/{path.name}")) as container:
        monkeypatch.setattr(web_object.WebObject, "_begin", failing)
        with pytest.raises((StorageFailed, StorageChanged)) as caught:
            recordings.read(container)
        assert container.losses == []
        assert "Errno" not in str(caught.value)


def build_large(recordings: Any, path: Path) -> Path:
    """Far more than one request brings when it is opened."""
    messages = recordings.some(20_000)
    if path.suffix == ".bag":
        return recordings.bag(path, messages, chunk_bytes=200_000)
    return recordings.mcap(path, messages, chunk_size=200_000)


def test_remote_files_of_other_formats_are_refused_like_local_ones(web: Any, bucket: Any) -> None:
    (web.folder / "page").write_text("<html>")
    (web.folder / "empty").touch()
    bucket.pipe_file(f"{bucket.name}/folder/notes.txt", b"no recording")
    for url, error in (
        (f"{web.url}/page", NotARecording),
        (f"{web.url}/empty", NotARecording),
        (f"{web.url}/gone", RecordingNotFound),
        (f"s3://{bucket.name}/gone", RecordingNotFound),
        (f"s3://{bucket.name}/folder", RecordingNotFound),
        (f"s3://{bucket.name}/folder/notes.txt", NotARecording),
    ):
        with pytest.raises(error):
            open_container(to_path(url))


@pytest.mark.parametrize("name", ["walk.mcap", "walk.bag"])
def test_log_times_cost_no_more_than_the_index(recordings: Any, web: Any, name: str) -> None:
    """Not even the blocks around the message indexes, which would be most of the file."""
    path = build_large(recordings, web.folder / name)
    with open_container(path) as local, open_container(to_path(f"{web.url}/{name}")) as remote:
        here, there = (
            {channel.topic: (pulse.messages, pulse.rates_hz()) for channel, pulse in indexed_pulses(each).items()}
            for each in (local, remote)
        )
    assert here == there
    listed_bytes = 20_000 * 16
    assert web.sent_bytes < listed_bytes + 3 * BLOCK_BYTES
    assert web.sent_bytes < path.stat().st_size / 2
