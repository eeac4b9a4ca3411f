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

from quadlog.cli.main import run
from quadlog.pipelines.executor import dask_cluster

FIXTURES = Path(__file__).parents[2] / "fixtures"


@pytest.fixture
def two(tmp_path):
    """Arguments that replay two copies of the committed recording."""
    for name in ("a", "b"):
        shutil.copy(FIXTURES / "follow.mcap", tmp_path / f"{name}.mcap")
    recordings = [str(tmp_path / f"{name}.mcap") for name in "ab"]
    return [*recordings, "-c", str(FIXTURES / "follow.toml"), "-o", str(tmp_path / "runs")]


def test_failures_are_the_last_lines_with_a_count(tmp_path, two, capsys):
    for name in ("broken", "empty"):
        (tmp_path / f"{name}.bag").write_text("no bag")
        two.insert(0, str(tmp_path / f"{name}.bag"))
    assert run(["replay", *two, "--until", "ingest", "--jobs", "1"]) == 3
    captured = capsys.readouterr()
    last = captured.err.splitlines()[-3:]
    assert last[0] == "2 of 4 recordings failed:"
    assert [line.split(": ")[0].strip() for line in last[1:]] == [
        str(tmp_path / f"{n}.bag") for n in ("broken", "empty")
    ]
    assert str(tmp_path / "runs" / "a") in captured.out
    assert "broken" not in captured.out


def test_a_dry_run_tells_the_time_of_all_once_one_has_run(two, capsys):
    assert run(["replay", *two, "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "2 of 2 to replay, " in out.splitlines()[-1]
    assert "how long that takes is known once one has run" in out
    assert run(["replay", *two[:1], *two[2:], "--until", "ingest"]) == 0
    capsys.readouterr()
    assert run(["replay", *two, "--until", "ingest", "--resume", "--dry-run", "--jobs", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[:2]] == ["skip", "run"]
    assert lines[-1].startswith("1 of 2 to replay, ")
    assert "; about " in lines[-1]
    assert lines[-1].endswith(" with 1 worker")  # the other one would have nothing to do
    assert run(["replay", *two, "--until", "ingest", "--force", "--dry-run", "--jobs", "1000000000"]) == 0
    assert capsys.readouterr().out.endswith(" with 2 workers\n")
    assert run(["replay", *two, "--until", "ingest", "--resume", "--dry-run", "--json"]) == 0
    captured = capsys.readouterr()
    rows = json.loads(captured.out)
    assert rows[0]["expected_s"] == 0
    assert rows[1]["expected_s"] > 0
    assert rows[1]["size_bytes"] == (FIXTURES / "follow.mcap").stat().st_size
    assert "1 of 2 to replay" in captured.err


def test_a_scheduler_has_its_own_workers(two, capsys):
    assert run(["replay", *two, "--scheduler", "tcp://127.0.0.1:1", "--jobs", "2"]) == 2
    assert "--scheduler and --jobs exclude each other" in capsys.readouterr().err


def test_an_address_without_a_scheduler_is_one_line(two, capsys, monkeypatch):
    monkeypatch.setattr(dask_cluster, "ANSWER_S", 0.2)
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{closed.getsockname()[1]}"
        assert run(["replay", *two, "--scheduler", address]) == 1
    assert capsys.readouterr().err == f"quadlog: --scheduler {address}: no Dask scheduler has answered within 0.2 s\n"
    assert not Path(two[-1]).exists()
    assert run(["replay", *two, "--scheduler", "my cluster"]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def start(arguments, **options):
    script = "from quadlog.cli.main import main; main()"
    command = [sys.executable, "-c", script, "replay", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_all_workers_and_leaves_what_resume_goes_on_from(tmp_path, two, capsys, number):
    process = start([*two, "--jobs", "2", "--until", "map"], start_new_session=True)
    while not list(tmp_path.glob("runs/*/poses.parquet")):  # at least one worker is in the midst of its work
        assert process.poll() is None, process.communicate()
        time.sleep(0)
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
    assert run(["replay", *two, "--jobs", "1", "--until", "position", "--resume"]) == 0


def test_a_disk_without_room_ends_the_batch_in_one_line_and_resume_goes_on(tmp_path, two, capsys):
    """A limit on the size of files stands for the disk: what writes gets the same kind of error."""
    most = 20_000

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
    assert run(["replay", *two, "--jobs", "1", "--until", "position", "--resume"]) == 0
