"""What tells a remote input from others, and what of its URL is saved."""

from __future__ import annotations

from typing import Any

import pytest
from aiohttp import web as http

from quadlog.errors import RecordingNotFound
from quadlog.results.run.record import InputRecord, RunRecord, describe_input, input_bytes
from quadlog.storage.remote_path import to_path


def test_a_file_is_told_by_size_and_etag(web: Any) -> None:
    (web.folder / "walk.mcap").write_bytes(b"12345")
    path = to_path(f"{web.url}/walk.mcap?sig=SECRET")
    told = describe_input(path)
    assert (told.path, told.size_bytes, told.sha256) == (f"{web.url}/walk.mcap?...", 5, None)
    assert told.etag
    assert told.identity == describe_input(path).identity
    assert web.sent_bytes == 2
    (web.folder / "walk.mcap").write_bytes(b"54321")
    assert describe_input(path).identity != told.identity
    with pytest.raises(RecordingNotFound):
        describe_input(to_path(f"{web.url}/gone"))


@pytest.mark.parametrize(("headers", "same"), [({"Last-Modified": "Sun, 22 Nov 2026 07:19:15 GMT"}, True), ({}, False)])
def test_without_an_etag_the_date_counts_and_without_either_nothing_does(
    web: Any, headers: dict[str, str], same: bool
) -> None:
    web.answer = lambda _: http.Response(body=b"12345", headers=headers)
    path = to_path(f"{web.url}/walk.mcap")
    first, second = describe_input(path), describe_input(path)
    assert first.etag is None
    assert (first.identity == second.identity) is same
    assert (InputRecord.identity_in({"path": "x", "size_bytes": 5, **headers_of(first)}) == first.identity) is same


def headers_of(record: InputRecord) -> dict[str, str]:
    return {} if record.last_modified is None else {"last_modified": record.last_modified}


def test_a_file_of_unknown_size_is_never_the_same(web: Any) -> None:
    async def endless(request: http.Request) -> http.StreamResponse:
        response = http.StreamResponse(headers={"ETag": '"x"'})
        await response.prepare(request)
        await response.write(b"12345")
        return response

    web.answer = endless
    path = to_path(f"{web.url}/walk.mcap")
    assert input_bytes([path]) == 0
    assert describe_input(path).identity != describe_input(path).identity


def test_a_bag_folder_is_told_by_all_its_files(bucket: Any) -> None:
    for number in range(2):
        bucket.pipe_file(f"{bucket.name}/bag/bag_{number}.mcap", b"%d" % number)
    path = to_path(f"s3://{bucket.name}/bag")
    told = describe_input(path)
    assert told.size_bytes == input_bytes(path.iterdir()) == 2
    assert describe_input(to_path(f"s3://{bucket.name}/bag")) == told
    bucket.pipe_file(f"{bucket.name}/bag/bag_1.mcap", b"2")
    assert describe_input(to_path(f"s3://{bucket.name}/bag")).identity != told.identity


def test_no_command_is_saved_with_its_secrets() -> None:
    typed = ["quadlog", "replay", "https://me:SECRET@h/x?sig=SECRET", "-o", "s3://b/runs"]
    record = RunRecord("1", typed, {}, {}, InputRecord("x", 1, "ab"), 0, 1.0)
    assert record.command == ["quadlog", "replay", "https://h/x?...", "-o", "s3://b/runs"]
    assert record.to_dict()["input"] == {"path": "x", "size_bytes": 1, "sha256": "ab"}


@pytest.mark.parametrize("saved", [None, [], {}, {"path": 3}, {"size_bytes": 1}])
def test_what_is_no_input_has_no_identity(saved: Any) -> None:
    assert InputRecord.identity_in(saved) is None
