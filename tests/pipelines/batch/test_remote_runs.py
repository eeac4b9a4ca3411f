"""Runs in a bucket are those of a folder: what is published, in which order, and what a second machine does to it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import quadlog
from quadlog.errors import AlreadyExists
from quadlog.pipelines.batch import summary
from quadlog.pipelines.batch.summary import note_failure, summarise
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.replay import replay as replay_anywhere
from quadlog.pipelines.request import Existing, ReplayOutcome, ReplayRequest
from quadlog.results.find_runs import OWN_FILES, runs_here
from quadlog.results.tables import read_table
from quadlog.storage.remote_path import RemotePath, to_path
from tests.lab.kept import Kept
from tests.pipelines.conftest import fixture_request, results_of


@pytest.fixture
def request_there(bucket: Any) -> ReplayRequest:
    """The committed recording in a bucket, to be replayed into it."""
    top = to_path(f"s3://{bucket.name}")
    request = fixture_request(top / "runs/walk", until="map")
    bucket.put_file(str(request.recording), f"{bucket.name}/season/walk.mcap")
    return replace(request, recording=top / "season/walk.mcap")


def names(bucket: Any, folder: str = "runs/walk") -> set[str]:
    top = f"{bucket.name}/{folder}/"
    return {path.removeprefix(top) for path in bucket.find(top)}


def test_a_run_in_a_bucket_is_the_run_of_a_folder(request_there: ReplayRequest, bucket: Any, tmp_path: Path) -> None:
    outcome = replay_anywhere(request_there, Silent())
    assert (outcome.exit_code, outcome.run) == (0, request_there.run)
    there = fixture_request(tmp_path / "walk", until="map")
    local = replay(there, Silent())
    assert outcome.metrics.keys() == local.metrics.keys()
    with runs_here([request_there.run], OWN_FILES) as ((here,), _):
        ours, theirs = results_of(here), results_of(tmp_path / "walk")
        assert names(bucket) == theirs.keys()
        pictures = {name for name in theirs if name.startswith("plots/")}  # nothing is read of them
        record, _ = ours.pop("run.json"), theirs.pop("run.json")
        assert ours == {name: content for name, content in theirs.items() if name not in pictures}
    told = record["input"]
    assert told["path"] == str(request_there.recording)
    assert told["size_bytes"] == there.recording.stat().st_size
    assert told["etag"] == bucket.info(f"{bucket.name}/season/walk.mcap")["ETag"]
    assert "sha256" not in told
    assert quadlog.load_run(str(request_there.run)).metrics.keys() == outcome.metrics.keys()


@pytest.fixture
def small(request_there: ReplayRequest) -> ReplayRequest:
    """What is published, and when, does not depend on how much it is."""
    options = replace(request_there.options, until="ingest", duration_s=0.1)
    return replace(request_there, options=options, plots=False)


def test_what_is_there_is_refused_kept_or_replaced(small: ReplayRequest, bucket: Any) -> None:
    replay_anywhere(small, Silent())
    written = bucket.info(f"{bucket.name}/runs/walk/run.json")["ETag"]
    with pytest.raises(AlreadyExists, match="--resume"):
        replay_anywhere(small, Silent())
    replay_anywhere(replace(small, existing=Existing.RESUME), heard := Kept())
    assert heard.lines == [f"{small.run}: already done with the same input, config and version"]
    assert bucket.info(f"{bucket.name}/runs/walk/run.json")["ETag"] == written
    bucket.pipe_file(f"{bucket.name}/runs/walk/notes.txt", b"mine")
    before = names(bucket)
    replay_anywhere(replace(small, existing=Existing.FORCE), Silent())
    assert names(bucket) == before


def test_the_record_goes_first_and_comes_last(small, bucket, monkeypatch):
    replay_anywhere(small, Silent())
    done: list[tuple[str, str]] = []
    upload, unlink = RemotePath.upload_all, RemotePath.unlink
    monkeypatch.setattr(
        RemotePath,
        "upload_all",
        lambda at, folder, names: (done.extend(("put", name) for name in names), upload(at, folder, names)),
    )
    monkeypatch.setattr(RemotePath, "unlink", lambda at, *_, **__: (done.append(("delete", at.name)), unlink(at)))
    replay_anywhere(replace(small, existing=Existing.FORCE), Silent())
    assert [each for each in done if each[1] == "run.json"] == [("put", "run.json")] * 2
    assert done[0] == done[-2] == ("put", "run.json")
    assert done[-1] == ("delete", "failed.json")


@pytest.mark.parametrize("where", ["bucket", "folder"])
def test_two_machines_do_not_lose_each_other_s_rows(small, bucket, tmp_path, monkeypatch, where):
    """The other one finishes a run while this one writes its summary, and had written its own before that."""
    top = to_path(f"s3://{bucket.name}/runs") if where == "bucket" else tmp_path / "runs"
    request = replace(small, run=top / "ours")
    replay_anywhere(request, Silent())
    broken = ReplayOutcome(request.recording, top / "broken", 1, "not a recording: unknown file format")
    note_failure(broken)
    summarise(top, Silent())
    write_table, written = summary.write_table, []

    def write_and_be_late(path: Path, *columns: Any) -> None:
        write_table(path, *columns)
        if not written:
            replay_anywhere(replace(request, run=top / "theirs"), Silent())
        written.append(path)

    monkeypatch.setattr(summary, "write_table", write_and_be_late)
    summarise(top, Silent())
    folder = tmp_path / "fetched"
    folder.mkdir()
    (folder / "summary.parquet").write_bytes((top / "summary.parquet").read_bytes())
    table = read_table(folder, "summary")
    assert list(table["recording"]) == ["broken", "ours", "theirs"]
    assert list(table["exit_code"]) == [1, 0, 0]
    assert table["reason"][0] == broken.reason
    assert table["wall_s"][2] > 0
    assert len(written) == 2
    page = (top / "report.html").read_bytes().decode()
    assert all(f"./{run}/report.html" in page for run in ("ours", "theirs"))
    assert "./broken/" not in page
