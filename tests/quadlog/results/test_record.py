from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest
from aiohttp import web as http

from quadlog.config.schema import Config
from quadlog.errors import NotARun, RecordingNotFound, UnknownRunFormat
from quadlog.results.record import (
    InputRecord,
    RunRecord,
    describe_input,
    describe_input_aside,
    input_bytes,
    read_metrics,
    read_record,
)
from quadlog.results.run import Run, finish_run
from quadlog.storage.remote_path import to_path

REQUIRED: dict[str, Any] = {"quadlog_version": "1", "config": Config(), "options": {}, "seed": 0, "recorded_s": 1.0}


def test_a_name_that_is_no_text_comes_back_and_secrets_are_not_saved(tmp_path: Path) -> None:
    typed = ["quadlog", "replay", "https://me:SECRET@h/x?sig=SECRET", "\udcff", "-o", "s3://b/runs"]
    record = RunRecord(command=typed, input=InputRecord(path="\udcff", size_bytes=1, sha256="ab"), **REQUIRED)
    finish_run(Run(tmp_path, record), record)
    back = read_record(tmp_path)
    assert back.command == ["quadlog", "replay", "https://h/x?...", "\udcff", "-o", "s3://b/runs"]
    assert back.input == record.input


LONG = "x\n" * 5000
DAMAGE: list[dict[str, Any]] = [
    *({"config": each} for each in (3, None, [[1] * 1000], {LONG: 1}, {"planner": {"name": LONG}})),
    *({"config": {"uwb": {"anchors": [[[each] * 99]]}}} for each in (1, "x", None)),
    *({"counts": {LONG: "x"}}, {"input": {"path": 3, "size_bytes": 1}}, {"input": {"size_bytes": 1}}),
    *({"seed": LONG}, {"command": LONG}, {"losses": [LONG]}),
]
BYTES = (b"", b"{", b"{}", b"[]", b"\xff\xfe", b"[" * 100_000, b'{"config":' * 9000)
NUMBERS = ("1" + "0" * 400, "1" * 5000, str(2**64), str(-(2**63) - 1), "1e999", "Infinity", "NaN")
SOUND = {"value": 2, "n": 5, "unit": "m"}
WRONG: list[dict[str, Any]] = [{"n": -1}, {"n": 1.5}, {"unit": 3}, {"value": True}, {"value": None}, {"low": "x"}]
METRICS = ("", "{", "[]", "[" * 100_000, '{"eta_m": 3}', json.dumps({"x\n" * 5000: {}}))


@pytest.mark.parametrize("damage", [*DAMAGE, *BYTES, *({"seed": number} for number in NUMBERS)])
def test_a_damaged_record_is_one_short_line(tiny_run: Path, damage: dict[str, Any] | bytes) -> None:
    if isinstance(damage, dict):
        number, text = damage.get("seed"), json.dumps(json.loads((tiny_run / "run.json").read_text()) | damage)
        damage = (text.replace(f'"{number}"', number) if number in NUMBERS else text).encode()
    (tiny_run / "run.json").write_bytes(damage)
    with pytest.raises(NotARun, match="is damaged") as raised:
        read_record(tiny_run)
    assert len(str(raised.value).removeprefix(str(tiny_run))) < 300
    assert str(raised.value).isprintable()


@pytest.mark.parametrize(
    "damage",
    [
        *METRICS,
        *(json.dumps({"eta_m": SOUND | wrong}) for wrong in WRONG),
        *(json.dumps({"eta_m": SOUND}).replace("2", number) for number in NUMBERS),
    ],
)
def test_damaged_metrics_are_one_short_line(tmp_path: Path, damage: str) -> None:
    (tmp_path / "metrics.json").write_text(damage)
    with pytest.raises(NotARun, match=r"metrics\.json: is damaged: [^\n]{1,300}$"):
        read_metrics(tmp_path)


@pytest.mark.parametrize("found", [2, "1\n", 1.0, True, [1] * 1000])
def test_another_format_is_refused_by_name_and_fields_of_later_versions_are_not(
    tiny_run: Path, tmp_path: Path, found: object
) -> None:
    (tmp_path / "run.json").write_text(json.dumps({"run_format": found, "quadlog_version": "9.8.7"}))
    with pytest.raises(UnknownRunFormat, match=r"a run of format .*by quadlog 9\.8\.7; this .* reads format 1") as told:
        read_record(tmp_path)
    assert len(str(told.value)) < 400
    content = json.loads((tiny_run / "run.json").read_text())
    del content["run_format"]  # as of an earlier version
    (tiny_run / "run.json").write_text(json.dumps(content | {"of_later": 1}))
    assert read_record(tiny_run).run_format == 1


def test_a_files_hash_is_that_of_sha256sum_in_a_thread_too(tmp_path: Path) -> None:
    content = bytes(range(256)) * 10_000
    (tmp_path / "walk.mcap").write_bytes(content)
    found = describe_input(tmp_path / "walk.mcap")
    assert (found.size_bytes, found.sha256) == (len(content), hashlib.sha256(content).hexdigest())
    assert describe_input_aside(tmp_path / "walk.mcap").result() == found
    with pytest.raises(RecordingNotFound, match=r"gone\.mcap: no such file"):
        describe_input_aside(tmp_path / "gone.mcap").result()
    with pytest.raises(RecordingNotFound, match="no regular file"):
        describe_input(Path("/dev/zero"))


def test_a_folders_hash_is_of_names_borders_and_contents_of_its_recordings(tmp_path: Path) -> None:
    def described(**files: bytes) -> str | None:
        folder = tmp_path / str(files)
        folder.mkdir()
        for name, content in files.items():
            (folder / f"{name}.mcap").write_bytes(content)
        (folder / "runs").mkdir()
        before = describe_input(folder)
        for name in ("notes.txt", "runs/derived.mcap"):
            (folder / name).write_text("no part of the recording")
        assert describe_input(folder) == before
        return before.sha256

    assert len({described(a=b"xy", b=b""), described(a=b"x", b=b"y"), described(a=b"xy", c=b""), described()}) == 4


def test_a_file_behind_a_url_has_size_and_etag(web: Any) -> None:
    (web.folder / "walk.mcap").write_bytes(b"12345")
    path = to_path(f"{web.url}/walk.mcap?sig=SECRET")
    found = describe_input(path)
    assert (found.path, found.size_bytes, found.sha256) == (f"{web.url}/walk.mcap?...", 5, None)
    assert found.identity == describe_input(path).identity
    (web.folder / "walk.mcap").write_bytes(b"54321")
    assert describe_input(path).identity != found.identity
    with pytest.raises(RecordingNotFound):
        describe_input(to_path(f"{web.url}/gone"))


@pytest.mark.parametrize(("headers", "same"), [({"Last-Modified": "Sun, 22 Nov 2026 07:19:15 GMT"}, True), ({}, False)])
def test_only_what_is_known_to_be_the_same_is(web: Any, headers: dict[str, str], same: bool) -> None:
    web.answer = lambda _: http.Response(body=b"12345", headers=headers)
    first, second = (describe_input(to_path(f"{web.url}/walk.mcap")) for _ in range(2))
    assert (first.identity == second.identity) is same


def test_a_bag_folder_in_a_bucket_is_all_its_files(bucket: Any) -> None:
    for number in range(2):
        bucket.pipe_file(f"{bucket.name}/bag/bag_{number}.mcap", b"%d" % number)
    path = to_path(f"s3://{bucket.name}/bag")
    found = describe_input(path)
    assert found.size_bytes == input_bytes(path.iterdir()) == 2
    assert describe_input(to_path(f"s3://{bucket.name}/bag")) == found
    bucket.pipe_file(f"{bucket.name}/bag/bag_1.mcap", b"2")
    assert describe_input(to_path(f"s3://{bucket.name}/bag")).identity != found.identity
