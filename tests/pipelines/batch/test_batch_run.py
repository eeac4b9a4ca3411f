from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time

import pyarrow.parquet as pq
import pytest

from quadlog.errors import CannotWrite
from quadlog.pipelines.batch import run as batch_run
from quadlog.pipelines.batch import task as batch_task
from quadlog.pipelines.batch.batch import replay_batch
from quadlog.pipelines.batch.progress import BatchLines
from quadlog.pipelines.replay import replay as really_replay
from quadlog.pipelines.request import Existing
from quadlog.storage.atomic_write import part_prefix


class Assassin(BatchLines):
    """Kills the worker of a run when it says that it is in the midst of a stage, so many times."""

    def __init__(self, victim, times):
        self.lines, self.killed = [], []
        super().__init__(self.lines.append)
        self._victim, self._times = victim, times

    def hear(self, step):
        pid = int(step["worker"].rpartition(":")[2])
        amid = step["stage"] == "ingest" and step["run"] == self._victim
        if amid and pid not in self.killed and len(self.killed) < self._times:
            self.killed.append(pid)
            os.kill(pid, signal.SIGKILL)


@pytest.mark.nightly
def test_a_recording_whose_worker_is_killed_is_replayed_to_the_same_bytes(planned, replayed_season, saved, tmp_path):
    assassin = Assassin("walk.bag", times=1)
    outcome = replay_batch(planned(tmp_path / "runs", until="position"), 2, None, assassin)
    assert len(assassin.killed) == 1
    assert [run.failed for run in outcome.runs] == [True, False, False, False]
    for name in ("walk.mcap", "walk.bag", "walk.db3"):
        assert saved(tmp_path / "runs" / name) == saved(replayed_season / name), name
    assert not list((tmp_path / "runs").rglob(".*"))


@pytest.mark.nightly
def test_a_recording_that_kills_two_workers_is_named_and_resumed(planned, tmp_path):
    assassin = Assassin("walk.bag", times=2)
    outcome = replay_batch(planned(tmp_path / "runs"), 2, None, assassin)
    assert len(assassin.killed) == 2
    assert [run.failed for run in outcome.runs] == [True, True, False, False]
    reason = outcome.runs[1].reason
    assert reason.startswith("its worker was killed by signal 9, and so was the next one, ")
    assert reason.endswith(" MB at its peak; out of memory is the usual cause; --resume goes on")
    again = planned(tmp_path / "runs", "walk.bag", "walk.mcap", existing=Existing.RESUME)
    assert replay_batch(again, 1, None, BatchLines([].append)).exit_code == 0


def instead(monkeypatch, raised):
    """replay, but for recordings of which there is something else to raise; returns the runs begun. In one process."""
    begun = []

    def replay(request, progress):
        begun.append(request.run.name)
        progress.begin("ingest", None)
        if request.run.name in raised:
            raise raised[request.run.name]
        return really_replay(request, progress)

    monkeypatch.setattr(batch_task, "replay_anywhere", replay)
    return begun


NO_ROOM = ImportError("libzstd.so.1: failed to map segment from shared object")


@pytest.mark.parametrize("error", [MemoryError("no room"), RuntimeError("can't start new thread"), NO_ROOM], ids=repr)
@pytest.mark.usefixtures("in_this_process")
def test_one_that_is_out_of_memory_is_named_with_what_it_took(planned, tmp_path, monkeypatch, capsys, error):
    instead(monkeypatch, {"walk.bag": error})
    outcome = replay_batch(planned(tmp_path / "runs"), 1, None, BatchLines([].append))
    assert [run.failed for run in outcome.runs] == [True, True, False, False]
    assert outcome.runs[1].reason.startswith("out of memory, ")
    assert outcome.runs[1].reason.endswith(" MB at its peak; --resume goes on")
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize(("error", "ends"), [(NO_ROOM, False), (ImportError("No module named 'quadlog'"), True)])
@pytest.mark.usefixtures("in_this_process")
def test_a_worker_that_cannot_load_quadlog_ends_the_batch_unless_it_lacks_memory(
    planned, tmp_path, monkeypatch, error, ends
):
    batch, lines = planned(tmp_path / "runs"), []
    largest = max(batch, key=lambda each: each.size_bytes).request.run

    def task(given):
        if given.request.run == largest:
            raise error
        return batch_task.replay_task(given)

    monkeypatch.setattr(batch_run, "replay_task", task)
    outcome = replay_batch(batch, 1, None, BatchLines(lines.append))
    reasons = {run.run: run.reason for run in outcome.runs}
    if ends:
        assert all("a worker cannot load quadlog: No module" in reason for reason in reasons.values())
    else:
        assert reasons.pop(largest) == "out of memory; --resume goes on"
        assert not any("quadlog: " in reason for reason in reasons.values())
    assert any(line.startswith("stopping: ") for line in lines) == ends


@pytest.mark.usefixtures("in_this_process")
def test_a_bug_is_one_recordings_and_its_traceback_is_shown(planned, tmp_path, monkeypatch, capsys):
    instead(monkeypatch, {"walk.bag": ZeroDivisionError("by 0")})
    outcome = replay_batch(planned(tmp_path / "runs"), 1, None, BatchLines([].append))
    assert outcome.runs[1].reason == "a bug in quadlog: ZeroDivisionError: by 0"
    assert [run.failed for run in outcome.runs] == [True, True, False, False]
    assert "Traceback" in capsys.readouterr().err


def full_disk():
    error = CannotWrite("fixes.parquet", "No space left on device")
    error.__cause__ = OSError(errno.ENOSPC, "No space left on device")
    return error


@pytest.mark.nightly
@pytest.mark.parametrize("error", [full_disk(), OSError(errno.EDQUOT, "Disk quota exceeded", "tmp")])
@pytest.mark.usefixtures("in_this_process")
def test_a_full_disk_ends_the_batch_and_the_rest_can_be_resumed(planned, tmp_path, monkeypatch, error):
    batch, lines = planned(tmp_path / "runs"), []
    largest = sorted(batch, key=lambda each: -each.size_bytes)
    names = [each.request.run.name for each in largest]
    begun = instead(monkeypatch, {names[1]: error})
    outcome = replay_batch(batch, 1, None, BatchLines(lines.append))
    assert begun == names[:2]
    reasons = {run.run.name: run.reason for run in outcome.runs}
    assert reasons[names[0]] == ""
    assert all(reasons[name].startswith("not started: disk full") for name in names[2:])
    assert all(reasons[name].endswith("--resume goes on") for name in names[2:])
    (said,) = [line for line in lines if line.startswith("stopping: disk full")]
    assert said.count("--resume goes on") == 1
    summary = pq.read_table(tmp_path / "runs" / "summary.parquet").to_pandas()
    assert set(summary["recording"]) == set(names)
    monkeypatch.undo()
    again = replay_batch(planned(tmp_path / "runs", existing=Existing.RESUME), 1, None, BatchLines(lines.append))
    assert [run.failed for run in again.runs] == [True, False, False, False]


@pytest.mark.usefixtures("in_this_process")
def test_an_interrupt_says_how_many_are_done(planned, tmp_path, monkeypatch):
    batch, lines = planned(tmp_path / "runs"), []
    smallest = min(batch, key=lambda each: each.size_bytes).request.run.name
    instead(monkeypatch, {smallest: KeyboardInterrupt()})
    with pytest.raises(KeyboardInterrupt):
        replay_batch(batch, 1, None, BatchLines(lines.append))
    assert lines[-1] == "interrupted with 3 of 4 recordings done"


@pytest.mark.nightly
def test_ctrl_c_many_times_is_one(planned, tmp_path):
    """As typed, since a process has one way to take signals: until it has ended, which may be by the last of them."""
    recordings = [str(each.request.recording) for each in planned(tmp_path / "unused", "walk.bag", "walk.mcap")]
    command = ["-m", "quadlog", "replay", "--no-plots", *recordings, "-o", str(tmp_path / "runs")]
    process = subprocess.Popen([sys.executable, *command, "--jobs", "2"], stderr=subprocess.PIPE, text=True)
    while not list(tmp_path.glob("runs/*/config.toml")):
        assert process.poll() is None, process.communicate()
        time.sleep(0.002)
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
    _, err = process.communicate()
    assert process.returncode in (1, -signal.SIGINT)
    assert "Traceback" not in err
    assert err.count("interrupted with ") == 1
    assert not list((tmp_path / "runs").rglob("*.part"))


@pytest.mark.usefixtures("in_this_process")
def test_what_a_stopped_worker_had_not_finished_is_removed(planned, tmp_path, monkeypatch):
    """Its process has gone: that of a worker which a signal met between making a file and knowing of it."""
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    left = tmp_path / "runs" / "walk.bag" / f"{part_prefix(gone.pid)}00000000.part"

    def replay(request, progress):
        left.parent.mkdir(parents=True, exist_ok=True)
        left.write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(batch_task, "replay_anywhere", replay)
    with pytest.raises(KeyboardInterrupt):
        replay_batch(planned(tmp_path / "runs"), 1, None, BatchLines([].append))
    assert left.parent.is_dir()
    assert not left.exists()
