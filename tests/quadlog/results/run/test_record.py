from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aiohttp import web as http

from quadlog.errors import RecordingNotFound
from quadlog.results import read_run_json
from quadlog.results.run.record import InputRecord, RunRecord, describe_input, describe_input_aside, input_bytes
from quadlog.storage.remote_path import to_path


def test_run_json_says_all_the_contract_names(tiny_run: Path) -> None:
    record = read_run_json(tiny_run)
    assert record["realtime_factor"] == pytest.approx(4.0 / 0.8)
    assert record["quadlog_version"] == "0.1.0"
    assert record["command"] == ["quadlog", "replay", "walk.mcap"]
    assert record["config"]["planner"] == {"name": "ia_star"}
    assert record["input"] == {"path": "walk.mcap", "size_bytes": 1234, "sha256": "ab" * 32}
    assert record["seed"] == 0
    assert record["packages"]["numpy"] == np.__version__
    assert record["host"]["processors"] >= 1
    assert record["topics"][0]["why"] == "the only point cloud"
    assert record["losses"][0] == {
        "cause": "crc",
        "detail": "one chunk is damaged, from 1.0 s to 1.5 s",
        "topic": "/points",
        "count": 5,
    }
    assert record["stages"][0] == {"name": "ingest", "seconds": 0.5, "peak_memory_mb": 120.0}
    assert record["counts"] == {"scans": 40, "scans_without_pose": 0}
    assert record["warnings"] == ["no heading source: yaw is the course"]


def test_a_device_is_no_recording_and_is_not_read_to_its_end() -> None:
    with pytest.raises(RecordingNotFound, match="no regular file"):
        describe_input(Path("/dev/zero"))


def test_a_bag_folders_hash_covers_its_recordings_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "bag_0.mcap").write_bytes(b"one")
    (tmp_path / "metadata.yaml").write_text("version: 5")
    before = describe_input(tmp_path)
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "derived.mcap").write_bytes(b"a result")
    (tmp_path / "notes.txt").write_text("by hand")
    assert describe_input(tmp_path) == before
    (tmp_path / "bag_1.mcap").write_bytes(b"two")
    assert describe_input(tmp_path).sha256 != before.sha256


def test_a_files_hash_is_what_sha256sum_says(tmp_path: Path) -> None:
    content = bytes(range(256)) * 10_000
    (tmp_path / "walk.mcap").write_bytes(content)
    described = describe_input(tmp_path / "walk.mcap")
    assert described.size_bytes == len(content)
    assert described.sha256 == hashlib.sha256(content).hexdigest()


def test_a_folders_hash_sees_names_borders_and_contents(tmp_path: Path) -> None:
    def described(**files: bytes) -> str:
        folder = tmp_path / "-".join(["of", *files, *(each.decode() for each in files.values())])
        folder.mkdir()
        for name, content in files.items():
            (folder / f"{name}.mcap").write_bytes(content)
        return describe_input(folder).sha256

    assert len({described(a=b"xy", b=b""), described(a=b"x", b=b"y"), described(a=b"xy", c=b""), described()}) == 4
    assert describe_input(tmp_path / "of-a-b-xy-").size_bytes == 2


def test_what_is_described_aside_is_the_same_and_so_is_what_goes_wrong(tmp_path: Path) -> None:
    (tmp_path / "walk.mcap").write_bytes(bytes(1 << 22))
    assert describe_input_aside(tmp_path / "walk.mcap").result() == describe_input(tmp_path / "walk.mcap")
    with pytest.raises(RecordingNotFound, match=r"gone\.mcap: no such file"):
        describe_input_aside(tmp_path / "gone.mcap").result()


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
