"""`quadlog replay` of several recordings, as typed."""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from quadlog.pipelines.executor import cluster

FIXTURES = Path(__file__).parents[2] / "fixtures"


@pytest.fixture
def two(tmp_path):
    """Arguments that replay two copies of the committed recording."""
    for name in ("a", "b"):
        shutil.copy(FIXTURES / "follow.mcap", tmp_path / f"{name}.mcap")
    recordings = [str(tmp_path / f"{name}.mcap") for name in "ab"]
    return [*recordings, "--no-plots", "-c", str(FIXTURES / "follow.toml"), "-o", str(tmp_path / "runs")]


def test_failures_are_the_last_lines_with_a_count(tmp_path, two, quadlog):
    bad = [str(tmp_path / f"{name}.bag") for name in ("broken", "empty")]
    for path in bad:
        Path(path).write_text("no bag")
    done = quadlog("replay", *bad, *two, "--until", "ingest", "--jobs", "1")
    assert done.code == 3
    first, *last = done.err.splitlines()[-3:]
    assert first == "2 of 4 recordings failed:"
    assert [line.split(": ")[0].strip() for line in last] == bad
    *runs, page = done.out.splitlines()
    assert [line.split(": ")[0] for line in runs] == [str(tmp_path / "runs" / name) for name in "ab"]
    assert page == str(tmp_path / "runs" / "report.html")


def test_a_dry_run_says_what_would_be_done(two, quadlog, ok):
    assert ok("replay", *two, "--dry-run").splitlines()[-1].startswith("2 of 2 to replay, ")
    ok("replay", *two[:1], *two[2:], "--until", "ingest")
    again = ["replay", *two, "--until", "ingest", "--dry-run", "--resume"]
    lines = ok(*again).splitlines()
    assert [line.split()[0] for line in lines[:2]] == ["skip", "run"]
    assert lines[-1].startswith("1 of 2 to replay, ")
    done = quadlog(*again, "--json")
    assert json.loads(done.out)[1]["size_bytes"] == (FIXTURES / "follow.mcap").stat().st_size
    assert "1 of 2 to replay" in done.err


def test_a_scheduler_that_cannot_be_used_is_one_line(two, refused, monkeypatch):
    said = refused(2, "replay", *two, "--scheduler", "tcp://127.0.0.1:1", "--jobs", "2")
    assert "--scheduler and --jobs exclude each other" in said
    monkeypatch.setattr(cluster, "ANSWER_S", 0.2)
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{closed.getsockname()[1]}"
        said = refused(1, "replay", *two, "--scheduler", address)
    assert said == f"quadlog: --scheduler {address}: no Dask scheduler has answered within 0.2 s\n"
    assert not Path(two[-1]).exists()
    refused(1, "replay", *two, "--scheduler", "my cluster")


def start(arguments, **options):
    command = [sys.executable, "-m", "quadlog", "replay", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.nightly)])
def test_a_signal_stops_all_workers_and_leaves_what_resume_goes_on_from(tmp_path, two, ok, number):
    process = start([*two, "--jobs", "2", "--until", "map"], start_new_session=True)
    while not list(tmp_path.glob("runs/*/poses.parquet")):  # at least one worker is in the midst of its work
        assert process.poll() is None, process.communicate()
        time.sleep(0.002)
    if number is signal.SIGINT:
        os.killpg(process.pid, number)  # as a terminal does: to the workers, too
    else:
        process.send_signal(number)
    _, err = process.communicate()  # ends when the last process that could write has ended
    assert process.returncode == 1
    assert "interrupted with 0 of 2 recordings done" in err
    assert err.splitlines()[-1].endswith("nothing half-written was left, and --resume goes on")
    assert "Traceback" not in err
    assert not list((tmp_path / "runs").rglob("*.part"))
    assert not list((tmp_path / "runs").rglob("run.json"))
    ok("replay", *two, "--jobs", "1", "--until", "position", "--resume")


@pytest.mark.nightly
def test_a_disk_without_room_ends_the_batch_in_one_line_and_resume_goes_on(tmp_path, two, ok):
    """A limit on the size of files stands for the disk: what writes gets the same kind of error."""
    most = 40_000  # more than the page of the folder has, and less than a run's ranges

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    process = start([*two, "--jobs", "1", "--until", "position"], preexec_fn=limit)
    _, err = process.communicate()
    assert process.returncode == 1
    assert len([line for line in err.splitlines() if line.startswith("stopping: disk full")]) == 1
    # One task is given out ahead, so the second may have begun by the time the first has failed.
    assert re.search(r"b\.mcap: (not started|stopped): disk full", err), err
    assert "--resume goes on" in err
    assert "Traceback" not in err
    assert not list((tmp_path / "runs").rglob("run.json"))
    ok("replay", *two, "--jobs", "1", "--until", "position", "--resume")
