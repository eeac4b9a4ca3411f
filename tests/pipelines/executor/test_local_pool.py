from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import time
from concurrent.futures import CancelledError
from pathlib import Path

import pytest

from quadlog.errors import UnknownName, WorkerDied
from quadlog.pipelines.executor.local_pool import LEFT, THREAD_VARIABLES, LocalPool


def test_one_worker_takes_tasks_in_their_order_in_a_process_with_one_thread_for_each_library(tasks):
    heard = []
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    with LocalPool(1, listener=heard.append) as pool:
        futures = [pool.submit(tasks.talk, [number]) for number in range(20)]
        variables = [pool.submit(tasks.variable, name) for name in THREAD_VARIABLES]
        pids = {pool.submit(os.getpid).result() for _ in range(3)}
    assert [future.result() for future in futures] == [1] * 20
    assert heard == list(range(20))
    assert [future.result() for future in variables] == ["1"] * 3
    assert len(pids) == 1
    assert os.getpid() not in pids
    assert {name: os.environ.get(name) for name in THREAD_VARIABLES} == before


def test_a_killed_worker_costs_its_own_task_alone_and_is_replaced(tasks, gate):
    heard, first, second = queue.Queue(), gate("first"), gate("second")
    with LocalPool(2, listener=heard.put) as pool:
        killed, spared = pool.submit(tasks.held, first, "killed"), pool.submit(tasks.held, second, "spared")
        pids = {told["begun"]: told["pid"] for told in (heard.get(), heard.get())}
        os.kill(pids["killed"], signal.SIGKILL)
        assert killed.exception().died_with == -signal.SIGKILL
        assert "killed by signal 9" in str(killed.exception())
        third = pool.submit(os.getpid).result()  # the other one is busy
        assert third not in pids.values()
        assert not spared.done()
        second.write_bytes(b"")
        assert spared.result() == ("spared", pids["spared"])


def test_a_worker_that_was_killed_between_tasks_costs_none():
    with LocalPool(1) as pool:
        pid = pool.submit(os.getpid).result()
        os.kill(pid, signal.SIGKILL)
        os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
        assert pool.submit(os.getpid).result() != pid


def test_a_task_that_ends_its_process_is_one_that_died():
    with LocalPool(1) as pool:
        assert pool.submit(os._exit, 7).exception().died_with == 7
        assert pool.submit(abs, -3).result() == 3


def test_a_worker_starts_although_the_working_folder_was_deleted(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tmp_path.rmdir()
    with LocalPool(1) as pool:
        assert pool.submit(abs, -3).result() == 3
    with pytest.raises(FileNotFoundError):
        Path.cwd()


def test_what_a_task_printed_is_not_lost(capfd, monkeypatch):
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)
    with LocalPool(1) as pool:
        pool.submit(print, "said").result()
    assert capfd.readouterr().out == "said\n"


def test_errors_come_as_they_were_with_the_traceback_of_the_other_process(tasks):
    with LocalPool(1) as pool:
        error = pool.submit(tasks.fail, "named").exception()
        assert type(error) is UnknownName
        assert (error.kind, error.name, error.choices) == ("planner", "z_star", ["astar"])
        assert str(error) == "unknown planner 'z_star'; choose one of: astar"
        assert "in fail" in error.__notes__[0]


@pytest.mark.parametrize(
    ("task", "arguments", "says"),
    [
        ("fail", ("stubborn",), "Stubborn: own words"),
        ("fail", ("fragile",), "Fragile: of two"),
        ("unpicklable", (), "pickle"),
        ("talk", (lambda: None,), "pickle"),
    ],
)
def test_what_no_pickle_holds_is_that_tasks_error(tasks, task, arguments, says):
    with LocalPool(1) as pool:
        with pytest.raises(Exception, match=says):
            pool.submit(getattr(tasks, task), *arguments).result()
        assert pool.submit(abs, -3).result() == 3


def test_an_error_of_the_listener_is_its_tasks_and_no_answer_is_taken_for_anothers(tasks):
    def listen(message):
        if message == "bad":
            raise ValueError("no ear for that")

    with LocalPool(1, listener=listen) as pool:
        bad, good = pool.submit(tasks.talk, ["bad"]), pool.submit(tasks.talk, ["good", "good"])
        with pytest.raises(ValueError, match="no ear"):
            bad.result()
        assert good.result() == 2


def test_an_exception_stops_workers_which_clean_up_and_cancels_the_rest(tasks, gate, tmp_path):
    heard, folder = queue.Queue(), tmp_path / "work"
    folder.mkdir()
    with pytest.raises(KeyboardInterrupt), LocalPool(1, listener=heard.put) as pool:  # noqa: PT012
        running = pool.submit(tasks.held_with_files, gate("gate"), folder)
        waiting = pool.submit(abs, 1)
        heard.get()
        assert len(list(folder.iterdir())) == 2
        raise KeyboardInterrupt
    assert isinstance(running.exception(), WorkerDied)
    with pytest.raises(CancelledError):
        waiting.result()
    assert list(folder.iterdir()) == []


def stopped_amid(task, *arguments, first=int):
    """How a worker ends that is stopped when the task says that it has begun."""
    heard = queue.Queue()
    with pytest.raises(KeyboardInterrupt), LocalPool(1, listener=heard.put) as pool:  # noqa: PT012
        pool.submit(first)
        running = pool.submit(task, *arguments)
        heard.get()
        raise KeyboardInterrupt
    return running.exception().died_with


def test_a_worker_that_is_stopped_below_c_code_cleans_up_and_says_nothing(tasks, gate, tmp_path, capfd):
    folder = tmp_path / "work"
    folder.mkdir()
    assert stopped_amid(tasks.held_below_c, gate("gate"), folder) == LEFT
    assert list(folder.iterdir()) == []
    assert capfd.readouterr().err == ""


def test_what_is_broken_off_is_no_error_of_the_tasks_own(tasks, gate, capfd):
    assert stopped_amid(tasks.held_and_mistaken, gate("gate")) == LEFT
    assert capfd.readouterr().err == ""


def test_a_worker_ends_also_when_what_it_does_holds_it(tasks, gate):
    assert stopped_amid(tasks.held_by_force, gate("gate"), first=tasks.unwind_at_once) == LEFT


def test_a_worker_leaves_ctrl_c_to_its_parent(tasks, gate):
    heard, path = queue.Queue(), gate("gate")
    with LocalPool(1, listener=heard.put) as pool:
        future = pool.submit(tasks.held, path, "on")
        os.kill(heard.get()["pid"], signal.SIGINT)
        path.write_bytes(b"")
        assert future.result()[0] == "on"


def test_after_shutdown_nothing_is_taken_and_what_has_not_begun_can_be_cancelled(tasks, gate):
    heard, path = queue.Queue(), gate("gate")
    pool = LocalPool(1, listener=heard.put)
    running, waiting = pool.submit(tasks.held, path, "on"), pool.submit(abs, 1)
    heard.get()
    pool.shutdown(wait=False, cancel_futures=True)
    assert waiting.cancelled()
    with pytest.raises(RuntimeError, match="shut down"):
        pool.submit(abs, 1)
    path.write_bytes(b"")
    assert running.result()[0] == "on"
    pool.shutdown()


ORPHANING = """
import sys
import {tasks} as tasks
from quadlog.pipelines.executor.local_pool import LocalPool

if __name__ == "__main__":
    with LocalPool(1) as pool:
        pool.submit(tasks.held_and_writing, {gate!r}, {pipe!r}, {folder!r}).result()
"""


def test_workers_end_and_clean_up_when_their_parent_is_killed_amid_a_task(tasks, task_folder, gate, tmp_path):
    pipe, folder = gate("pipe"), tmp_path / "work"
    folder.mkdir()
    script = ORPHANING.format(tasks=tasks.__name__, gate=str(gate("gate")), pipe=str(pipe), folder=str(folder))
    (tmp_path / "parent.py").write_text(script)
    environ = os.environ | {"PYTHONPATH": os.pathsep.join([str(task_folder), os.environ.get("PYTHONPATH", "")])}
    parent = subprocess.Popen([sys.executable, str(tmp_path / "parent.py")], env=environ)
    with pipe.open("rb") as until_its_end:
        while len(list(folder.iterdir())) < 2:  # both files are there: it is amid its task
            assert parent.poll() is None
            time.sleep(0.002)
        parent.kill()
        parent.wait()
        until_its_end.read()
    assert list(folder.iterdir()) == []
