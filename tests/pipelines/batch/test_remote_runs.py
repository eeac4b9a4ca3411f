"""Runs in a bucket are those of a folder: what is published, in which order, and what a second machine does to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import quadlog
from quadlog.errors import AlreadyExists, CannotWrite, NothingReadable
from quadlog.pipelines import replay as remote_runs
from quadlog.pipelines.batch import summary
from quadlog.pipelines.batch.summary import note_failure, summarise
from quadlog.pipelines.executor.progress import Kept, Silent
from quadlog.pipelines.replay import replay
from quadlog.pipelines.replay import replay as replay_anywhere
from quadlog.pipelines.request import Existing, ReplayOutcome, ReplayRequest
from quadlog.pipelines.store import run_key
from quadlog.results.find_runs import OWN_FILES, runs_here
from quadlog.results.record import RunRecord, StageRecord, describe_input
from quadlog.results.run import Run, new_run
from quadlog.results.tables import read_table
from quadlog.storage.remote_path import RemotePath, to_path
from quadlog.version import __version__

FILES_UNTIL = {
    "position": ("fixes.parquet", "report.html"),
    "map": ("fixes.parquet", "maps.npz", "dilution.npz", "report.html"),
}
Request = Callable[..., ReplayRequest]


@pytest.fixture
def request_there(follow_request: Request, bucket: Any) -> ReplayRequest:
    """The committed recording in a bucket, to be replayed into it."""
    top = to_path(f"s3://{bucket.name}")
    request = follow_request(top / "runs/walk", until="map")
    bucket.put_file(str(request.recording), f"{bucket.name}/season/walk.mcap")
    return replace(request, recording=top / "season/walk.mcap")


def names(bucket: Any, folder: str = "runs/walk") -> set[str]:
    top = f"{bucket.name}/{folder}/"
    return {path.removeprefix(top) for path in bucket.find(top)}


def test_a_run_in_a_bucket_is_the_run_of_a_folder(
    request_there: ReplayRequest, follow_request: Request, saved: Any, bucket: Any, tmp_path: Path
) -> None:
    outcome = replay_anywhere(request_there, Silent())
    assert (outcome.exit_code, outcome.run) == (0, request_there.run)
    there = follow_request(tmp_path / "walk", until="map")
    local = replay(there, Silent())
    assert outcome.metrics.keys() == local.metrics.keys()
    with runs_here([request_there.run], OWN_FILES) as ((here,), _):
        ours, theirs = saved(here), saved(tmp_path / "walk")
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


def small_replay(request: ReplayRequest, progress: Any) -> ReplayOutcome:
    """A run of a few bytes: what is published, and when, does not depend on what is in it."""
    metrics = {"eta_m": {"value": 0.25, "n": 3, "unit": "m"}}
    record = RunRecord(
        quadlog_version=__version__,
        command=request.command,
        config=request.config,
        options=request.options.to_dict(),
        input=describe_input(request.recording),
        seed=0,
        recorded_s=1.0,
        stages=[StageRecord(name="ingest", seconds=2.0, peak_memory_mb=300.0)],
        results={"run": run_key(request)},
    )
    with new_run(request.run, request.existing is not Existing.REFUSE) as place:
        for name in FILES_UNTIL[request.options.until]:
            (place / name).write_bytes(name.encode())
        run = Run.create(place, record)
        run.write("metrics", metrics)
        run.finish(record)
    return ReplayOutcome(request.recording, request.run, 0, metrics=metrics)


@pytest.fixture
def small(request_there: ReplayRequest, monkeypatch: pytest.MonkeyPatch) -> ReplayRequest:
    monkeypatch.setattr(remote_runs, "replay", small_replay)
    return request_there


def test_what_is_there_is_refused_kept_or_replaced(small: ReplayRequest, bucket: Any) -> None:
    replay_anywhere(small, Silent())
    written = bucket.info(f"{bucket.name}/runs/walk/run.json")["ETag"]
    with pytest.raises(AlreadyExists, match="--resume"):
        replay_anywhere(small, Silent())
    heard = Kept()
    finished = replay_anywhere(replace(small, existing=Existing.RESUME), heard)
    assert heard.lines == [f"{small.run}: already done with the same input, config and version"]
    assert finished.metrics["eta_m"]["value"] == 0.25
    assert bucket.info(f"{bucket.name}/runs/walk/run.json")["ETag"] == written
    bucket.pipe_file(f"{bucket.name}/runs/walk/notes.txt", b"mine")
    until_position = replace(small, options=replace(small.options, until="position"), existing=Existing.FORCE)
    replay_anywhere(until_position, Silent())
    assert names(bucket) == {"notes.txt", "config.toml", "metrics.json", "run.json", *FILES_UNTIL["position"]}


def test_another_input_of_the_same_name_is_another_run(small: ReplayRequest, bucket: Any) -> None:
    request = replace(small, existing=Existing.RESUME)
    replay_anywhere(request, Silent())
    bucket.pipe_file(f"{bucket.name}/season/walk.mcap", b"another one")
    heard = Kept()
    replay_anywhere(request, heard)
    assert heard.lines == []


def test_a_folder_of_somebody_else_is_left_alone(request_there: ReplayRequest, bucket: Any) -> None:
    bucket.pipe_file(f"{bucket.name}/runs/walk/thesis.tex", b"mine")
    for existing in Existing:
        with pytest.raises(CannotWrite, match="holds other files"):
            replay_anywhere(replace(request_there, existing=existing), Silent())
    assert names(bucket) == {"thesis.tex"}


@pytest.mark.parametrize("existing", [Existing.REFUSE, Existing.FORCE])
def test_what_is_interrupted_leaves_what_was_there(
    small: ReplayRequest, bucket: Any, monkeypatch: pytest.MonkeyPatch, existing: Existing
) -> None:
    def interrupted(request: ReplayRequest, progress: Any) -> ReplayOutcome:
        small_replay(request, progress)
        raise KeyboardInterrupt

    if existing is Existing.FORCE:
        replay_anywhere(small, Silent())
    before = {path: bucket.cat(path) for path in bucket.find(f"{bucket.name}/runs")}
    monkeypatch.setattr(remote_runs, "replay", interrupted)
    with pytest.raises(KeyboardInterrupt):
        replay_anywhere(replace(small, existing=existing), Silent())
    assert {path: bucket.cat(path) for path in bucket.find(f"{bucket.name}/runs")} == before


def test_the_record_goes_first_and_comes_last(
    small: ReplayRequest, bucket: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_a_recording_that_cannot_be_read_leaves_nothing(request_there: ReplayRequest, bucket: Any) -> None:
    bucket.pipe_file(f"{bucket.name}/season/walk.mcap", b"\x89MCAP0\r\n" + bytes(100))
    with pytest.raises(NothingReadable):
        replay_anywhere(request_there, Silent())
    assert names(bucket) == set()


@pytest.mark.parametrize("where", ["bucket", "folder"])
def test_two_machines_do_not_lose_each_other_s_rows(
    small: ReplayRequest, bucket: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
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
    assert table["wall_s"][2] == 2.0
    assert table["eta_m"][2] == 0.25
    assert len(written) == 2
    page = (top / "report.html").read_bytes().decode()
    assert all(f"./{run}/report.html" in page for run in ("ours", "theirs"))
    assert "./broken/" not in page


@pytest.mark.usefixtures("without_pictures")
def test_from_python_both_may_be_urls(request_there: ReplayRequest, bucket: Any) -> None:
    run = quadlog.replay(request_there.recording.url, output=f"s3://{bucket.name}/runs", until="position")
    assert len(run.table("poses")) > 0
    assert f"{bucket.name}/runs/summary.parquet" in bucket.find(f"{bucket.name}/runs")
