"""Workers here and on a cluster: results, deaths and stops, and a batch on a cluster."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

from quadlog.errors import QuadlogError, UnknownName, UsageError, VersionsDiffer, WorkerDied
from quadlog.pipelines.batch.batch import replay_batch
from quadlog.pipelines.executor import cluster
from quadlog.pipelines.executor.cluster import open_cluster
from quadlog.pipelines.executor.pool import LocalPool, open_executor
from quadlog.pipelines.executor.progress import BatchLines
from tests.pipelines.conftest import results_of

TASKS = '''
import os, tempfile
from pathlib import Path
from quadlog.errors import UnknownName
from quadlog.pipelines.executor.progress import tell
from quadlog.storage.atomic_write import whole_file

def held(gate, folder=None):
    """With a file begun in the folder and a temporary one, until the test opens the gate."""
    with tempfile.TemporaryDirectory() as temporary:
        if folder is None:
            tell([os.getpid(), temporary, Path(gate).name])
            Path(gate).read_bytes()
            return os.getpid()
        with whole_file(Path(folder, "whole")):
            return held(gate)

def held_with_pipe(gate, pipe, folder):
    """The pipe ends when this process does."""
    with open(pipe, "w"):
        held(gate, folder)

def die_if(kill):
    if kill:
        os.kill(os.getpid(), 9)
    return "alive"

def refuse(number):
    raise UnknownName("number", str(number), ["1"])

def talk(words):
    for word in words:
        tell(word)
    return len(words)
'''


@pytest.fixture(scope="session")
def task_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the module of tasks is, for those who set a path of their own."""
    return tmp_path_factory.mktemp("tasks")


@pytest.fixture(scope="session")
def tasks(task_folder: Path) -> Iterator[ModuleType]:
    """The module of tasks."""
    (task_folder / "quadlog_test_tasks.py").write_text(TASKS)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(task_folder))
        yield import_module("quadlog_test_tasks")


@pytest.fixture(scope="session")
def scheduler(tasks: ModuleType) -> Iterator[str]:
    """The address of a cluster of two workers, each with a nanny that starts it again when it dies."""
    from distributed import LocalCluster

    # A port of its own, beside whatever else runs on this machine, and no pages behind it.
    quiet = {"dashboard_address": "127.0.0.1:0", "scheduler_kwargs": {"dashboard": False}}
    with LocalCluster(n_workers=2, threads_per_worker=2, host="127.0.0.1", **quiet) as cluster:
        yield cluster.scheduler_address


@pytest.fixture
def gate(tmp_path: Path) -> Callable[[str], Path]:
    """Makes a named pipe: whoever reads it waits until it has been opened to write."""

    def make(name: str) -> Path:
        path = tmp_path / name
        os.mkfifo(path)
        return path

    return make


@pytest.mark.parametrize("place", ["processes", pytest.param("cluster", marks=pytest.mark.nightly)])
def test_results_errors_messages_and_deaths_come_back(tasks, request, place):
    with open_executor(2, request.getfixturevalue("scheduler") if place == "cluster" else None) as workers:
        assert workers.count() == 2
        talks = [workers.submit(tasks.talk, [number]) for number in range(9)]
        assert [future.result() for future in talks] == [1] * 9
        assert sorted(workers.messages.get() for _ in talks) == list(range(9))
        error = workers.submit(tasks.refuse, -1).exception()
        assert (type(error), error.kind, error.choices) == (UnknownName, "number", ["1"])
        assert isinstance(workers.submit(tasks.die_if, True).exception(), workers.death)
        assert workers.submit(tasks.die_if, False).result() == "alive"


def test_a_killed_worker_costs_its_own_task_alone_and_leaves_no_temporary_file(tasks, gate):
    first, second = gate("first"), gate("second")
    with LocalPool(2) as pool:
        killed, spared = pool.submit(tasks.held, first), pool.submit(tasks.held, second)
        told = {name: (pid, Path(folder)) for pid, folder, name in (pool.messages.get(), pool.messages.get())}
        os.kill(told["first"][0], signal.SIGKILL)
        assert isinstance(killed.exception(), WorkerDied)
        assert not told["first"][1].exists()
        assert pool.submit(os.getpid).result() not in (told["first"][0], told["second"][0])  # the other one is busy
        second.write_bytes(b"")
        assert spared.result() == told["second"][0]


def test_without_a_working_folder_no_worker_is_started(tmp_path, monkeypatch):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    with pytest.raises(UsageError, match="the working folder was removed"), open_executor(2, None):
        pass


def test_a_stop_ends_what_runs_and_what_waits_at_once(tasks, gate, tmp_path):
    """As on a full disk, and by Ctrl-C: nothing is waited for that no worker will ever begin."""
    folder = tmp_path / "work"
    folder.mkdir()
    with pytest.raises(KeyboardInterrupt), LocalPool(1) as pool:  # noqa: PT012
        running = pool.submit(tasks.held, gate("gate"), folder)
        waiting = pool.submit(abs, 1)
        pid, temporary, _ = pool.messages.get()
        began_s = time.monotonic()
        raise KeyboardInterrupt
    assert time.monotonic() - began_s < 2
    assert isinstance(running.exception(), WorkerDied)
    with pytest.raises(CancelledError):
        waiting.result()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    assert not Path(temporary).exists()


ORPHANING = """
import sys
import {tasks} as tasks
from quadlog.pipelines.executor.pool import LocalPool

if __name__ == "__main__":
    with LocalPool(1) as pool:
        pool.submit(tasks.held_with_pipe, {gate!r}, {pipe!r}, {folder!r})
        print(*pool.messages.get(), flush=True)
"""


def test_workers_end_and_clean_up_when_their_parent_is_killed_amid_a_task(tasks, task_folder, gate, tmp_path):
    pipe, folder = gate("pipe"), tmp_path / "work"
    folder.mkdir()
    script = ORPHANING.format(tasks=tasks.__name__, gate=str(gate("gate")), pipe=str(pipe), folder=str(folder))
    (tmp_path / "parent.py").write_text(script)
    environ = os.environ | {"PYTHONPATH": os.pathsep.join([str(task_folder), os.environ.get("PYTHONPATH", "")])}
    parent = subprocess.Popen(
        [sys.executable, str(tmp_path / "parent.py")], env=environ, stdout=subprocess.PIPE, text=True
    )
    with pipe.open("rb") as until_its_end:
        _, temporary, _ = parent.stdout.readline().split()
        assert len(list(folder.iterdir())) == 1  # it is amid its task
        parent.kill()
        parent.communicate()
        until_its_end.read()
    assert list(folder.iterdir()) == []
    assert not Path(temporary).exists()


def test_other_versions_are_refused_with_both_named(scheduler, monkeypatch):
    mine = cluster.own_versions()
    monkeypatch.setattr(cluster, "__version__", "9.9")
    monkeypatch.setattr(cluster, "package_versions", lambda: {"quadlog-no-such-package": "1.0"})
    with pytest.raises(VersionsDiffer) as caught, open_cluster(scheduler):
        pass
    words = f"quadlog {mine['quadlog']} instead of 9.9, quadlog-no-such-package none instead of 1.0"
    assert f" has {words}; install there" in str(caught.value)
    assert str(caught.value).startswith("worker tcp://127.0.0.1")


def test_who_cannot_be_used_is_named_in_one_line(monkeypatch):
    monkeypatch.setattr(cluster, "ANSWER_S", 0.2)
    with socket.socket() as deaf:
        deaf.bind(("127.0.0.1", 0))
        deaf.listen()
        silent = f"tcp://127.0.0.1:{deaf.getsockname()[1]}"
        for address, words in (("garbage", "is no address of a Dask scheduler"), (silent, "no Dask scheduler has")):
            with pytest.raises(QuadlogError, match=words) as caught, open_cluster(address):
                pass
            assert "\n" not in str(caught.value)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(QuadlogError, match=r"pip install 'quadlog\[cluster\]'"), open_cluster("tcp://h:1"):
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
    planned, replayed_season, scheduler, tmp_path, monkeypatch
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
        assert run.failed or results_of(run.run) == results_of(replayed_season / run.run.name)
    assert watching.lines[0].startswith("2 workers")
    assert {run.run.parent for run in outcome.runs} == {Path("runs")}
    assert not list(Path("runs").rglob("*.part"))


def test_a_recording_that_a_worker_does_not_see_is_named_with_the_worker(planned, scheduler, tmp_path):
    (only,) = planned(tmp_path / "runs", "walk.bag")
    only = replace(only, recording=Path("/nowhere/walk.bag"))
    outcome = replay_batch([only], 1, scheduler, Watching())
    assert outcome.runs[0].reason.startswith("no such file or folder (on tcp://127.0.0.1")
