"""What is asked of workers, here and on a cluster; and how processes of this machine die and are stopped."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import CancelledError
from pathlib import Path

import pytest

from quadlog.errors import UnknownName, WorkerDied
from quadlog.pipelines.executor.pool import THREAD_VARIABLES, LocalPool, open_executor


@pytest.mark.parametrize("place", ["processes", pytest.param("cluster", marks=pytest.mark.nightly)])
def test_results_errors_messages_and_deaths_come_back(tasks, request, place):
    with open_executor(2, request.getfixturevalue("scheduler") if place == "cluster" else None) as workers:
        assert workers.count() == 2
        talks = [workers.submit(tasks.talk, [number]) for number in range(9)]
        assert [future.result() for future in talks] == [1] * 9
        assert sorted(workers.messages.get() for _ in talks) == list(range(9))
        error = workers.submit(tasks.square_aloud, -1, None).exception()
        assert (type(error), error.kind, error.choices) == (UnknownName, "number", ["1"])
        assert isinstance(workers.submit(tasks.die_if, True).exception(), workers.death)
        assert workers.submit(tasks.die_if, False).result() == "alive"


def test_one_worker_takes_tasks_in_their_order_in_a_process_with_one_thread_for_each_library():
    with LocalPool(1) as pool:
        variables = [pool.submit(os.getenv, name) for name in THREAD_VARIABLES]
        pids = {pool.submit(os.getpid).result() for _ in range(3)}
    assert [future.result() for future in variables] == ["1"] * 3
    assert len(pids) == 1
    assert os.getpid() not in pids


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


def test_what_no_pickle_holds_is_that_tasks_error():
    with LocalPool(1) as pool:
        with pytest.raises(Exception, match="pickle"):
            pool.submit(print, lambda: None).result()
        assert pool.submit(abs, -3).result() == 3


def test_a_worker_leaves_ctrl_c_to_its_parent(tasks, gate):
    path = gate("gate")
    with LocalPool(1) as pool:
        future = pool.submit(tasks.held, path)
        pid, *_ = pool.messages.get()
        os.kill(pid, signal.SIGINT)
        path.write_bytes(b"")
        assert future.result() == pid


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
