"""Dask's workers: whose death another one makes up for, what they must have installed, and a batch on them."""

from __future__ import annotations

import os
import signal
import socket
import sys
from concurrent.futures import CancelledError
from dataclasses import replace
from pathlib import Path

import pytest

from quadlog.errors import ClusterUnusable, VersionsDiffer
from quadlog.pipelines.batch.batch import replay_batch
from quadlog.pipelines.executor import cluster
from quadlog.pipelines.executor.cluster import open_cluster
from quadlog.pipelines.executor.progress import BatchLines


def test_a_task_whose_worker_is_killed_is_done_by_another(tasks, scheduler, tmp_path):
    with open_cluster(scheduler) as workers:
        assert isinstance(workers.submit(tasks.die_once, tmp_path).result(), int)
    assert (tmp_path / "died").exists()


def test_what_runs_ends_when_it_is_stopped(tasks, scheduler, gate):
    pipe = gate("pipe")
    with open_cluster(scheduler) as workers:
        running = workers.submit(tasks.talk_on, pipe)
        with pipe.open("rb") as until_its_end:
            workers.stop()
            assert until_its_end.read() == b""
        with pytest.raises(CancelledError):
            running.result()


def test_other_versions_are_refused_with_both_named(scheduler, monkeypatch):
    mine = cluster.own_versions()
    other = {"quadlog": "9.9", "numba": "0.1", "quadlog-no-such-package": "1.0"}
    monkeypatch.setattr(cluster, "own_versions", lambda: mine | other)
    with open_cluster(scheduler) as workers:  # the workers are asked for what they say now
        error = workers.submit(abs, 1).exception()
    assert isinstance(error, VersionsDiffer)
    monkeypatch.undo()
    monkeypatch.setattr(cluster, "__version__", "9.9")
    monkeypatch.setattr(cluster, "package_versions", lambda: {"quadlog-no-such-package": "1.0"})
    with pytest.raises(VersionsDiffer) as caught, open_cluster(scheduler):
        pass
    words = f"quadlog {mine['quadlog']} instead of 9.9, quadlog-no-such-package none instead of 1.0"
    assert f" has {words}; install there" in str(caught.value)
    assert str(caught.value).startswith("worker tcp://127.0.0.1")


def test_who_cannot_be_used_is_named_in_one_line(scheduler, monkeypatch):
    from distributed import Client

    with Client(scheduler, set_as_default=False) as client:
        worker = next(iter(client.nthreads()))
    monkeypatch.setattr(cluster, "ANSWER_S", 0.2)
    with socket.socket() as deaf:
        deaf.bind(("127.0.0.1", 0))
        deaf.listen()
        asked = {
            "garbage": "is no address of a Dask scheduler",
            "foo://host:1": "is no address",
            "": "is no address",
            f"tcp://127.0.0.1:{deaf.getsockname()[1]}": "no Dask scheduler has answered within 0.2 s",
            worker: "is a Dask worker, not the scheduler",
        }
        for address, words in asked.items():
            with pytest.raises(ClusterUnusable, match=words) as caught, open_cluster(address):
                pass
            assert "\n" not in str(caught.value)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ClusterUnusable, match=r"pip install 'quadlog\[cluster\]'"), open_cluster("tcp://h:1"):
        pass


class Watching(BatchLines):
    """Kills the worker that says first that it is amid a recording."""

    def __init__(self, pids=None):
        self.lines, self.pids, self.killed = [], pids or {}, []
        super().__init__(self.lines.append)

    def hear(self, step):
        if self.pids and not self.killed:
            self.killed.append(step["worker"])
            os.kill(self.pids[step["worker"]], signal.SIGKILL)


def test_a_cluster_gives_the_same_bytes_also_when_a_worker_is_killed(
    planned, replayed_season, saved, scheduler, tmp_path, monkeypatch
):
    """Relative paths are found by workers elsewhere, and named as they were given."""
    from distributed import Client

    with Client(scheduler, set_as_default=False) as client:
        watching = Watching(client.run(os.getpid))
    monkeypatch.chdir(tmp_path)
    outcome = replay_batch(planned(Path("runs"), until="position"), 1, scheduler, watching)
    assert watching.killed
    assert outcome.exit_code == 3
    assert [run.failed for run in outcome.runs] == [True, False, False, False]
    for run in outcome.runs:
        assert run.failed or saved(run.run) == saved(replayed_season / run.run.name)
    assert watching.lines[0].startswith("2 workers")
    assert {run.run.parent for run in outcome.runs} == {Path("runs")}
    assert not list(Path("runs").rglob("*.part"))


def test_a_recording_that_a_worker_does_not_see_is_named_with_the_worker(planned, scheduler, tmp_path):
    (only,) = planned(tmp_path / "runs", "walk.bag")
    only = replace(only, request=replace(only.request, recording=Path("/nowhere/walk.bag")))
    outcome = replay_batch([only], 1, scheduler, Watching())
    assert outcome.runs[0].reason.startswith("no such file or folder (on tcp://127.0.0.1")


def test_a_cluster_without_workers_is_waited_for_aloud(planned, make_cluster, tmp_path):
    with make_cluster(0) as empty:

        class Scaling(Watching):
            def say(self, text):
                super().say(text)
                if text.startswith("no workers: waiting until one connects to "):
                    empty.scale(1)

        assert (
            replay_batch(planned(tmp_path / "runs", "walk.bag"), 1, empty.scheduler_address, Scaling()).exit_code == 0
        )
