from __future__ import annotations

import threading
import time
from collections import deque
from concurrent.futures import Future

import pytest
from dask.local import SynchronousExecutor

from quadlog.errors import UnknownName, WorkerDied
from quadlog.pipelines.executor import executor as engine_module
from quadlog.pipelines.executor.executor import Engine, open_engine, side_by_side
from quadlog.pipelines.executor.progress import Kept, tell, told_to, worker_name


@pytest.mark.parametrize("place", ["one process", "processes", pytest.param("cluster", marks=pytest.mark.nightly)])
def test_every_engine_does_each_task_once_and_hears_what_is_told(tasks, request, place):
    heard, said, todo = [], [], deque([[n] for n in range(9)])
    scheduler = request.getfixturevalue("cluster").scheduler_address if place == "cluster" else None
    with open_engine(2 if place == "processes" else 1, scheduler, heard.append) as engine:
        done = {task[0]: future.result() for task, future in engine.done(tasks.talk, todo, said.append)}
    assert said == []
    assert done == dict.fromkeys(range(9), 1)
    if place != "cluster":  # whose events come when they come
        assert sorted(heard) == list(range(9))


def test_a_stop_ends_the_tasks_that_wait_for_a_worker_too():
    """As on a full disk: a batch must not wait for what no worker will ever begin."""
    ended = []

    def stop_after_the_first():
        todo = deque([0.0] + [60.0] * 7)
        with open_engine(2, None, [].append) as engine:
            for _, future in engine.done(time.sleep, todo, [].append):
                ended.append(future)
                todo.clear()
                engine.stop()

    batch = threading.Thread(target=stop_after_the_first, daemon=True)
    batch.start()
    batch.join(20.0)
    assert not batch.is_alive(), "it waits for ever"
    assert ended[0].exception() is None
    assert [future for future in ended if future.cancelled()]


def test_no_more_tasks_are_given_out_than_there_is_room_for():
    given, most = [], []

    class Watched(SynchronousExecutor):
        def submit(self, fn, /, *args, **kwargs):
            most.append(len(given) - len(taken))
            given.append(args)
            return super().submit(fn, *args, **kwargs)

    taken, todo = [], deque(range(20))
    for task, _ in Engine(Watched(), lambda: 1, lambda: 3, lambda: None).done(abs, todo, [].append):
        taken.append(task)
        if task == 4:
            todo.appendleft(99)
    assert sorted(taken) == [*range(20), 99]
    assert taken.index(99) < taken.index(10)
    assert max(most) < 3


def test_that_all_workers_have_gone_is_said_once_and_so_is_that_one_has_come(monkeypatch):
    monkeypatch.setattr(engine_module, "LOOK_AGAIN_S", 0.0)
    rooms, given = iter([0, 0, 2, 1, 0, 0, 0, 1]), Future()

    class Slow(SynchronousExecutor):
        def submit(self, fn, /, *args, **kwargs):
            return given

    def room():
        there = next(rooms, None)
        if there is None:
            given.set_result("at last")
        return 1 if there is None else there

    said = []
    engine = Engine(Slow(), lambda: 0, room, lambda: None, address="tcp://h:1")
    assert [future.result() for _, future in engine.done(abs, deque([1]), said.append)] == ["at last"]
    waiting = "no workers: waiting until one connects to tcp://h:1; Ctrl-C stops, --resume goes on"
    assert said == [waiting, "a worker has connected: going on"] * 2


def test_a_cluster_without_workers_is_waited_for_aloud(empty_cluster):
    said = []
    with empty_cluster() as cluster:

        def say(words):
            said.append(words)
            cluster.scale(1)

        with open_engine(1, cluster.scheduler_address, [].append) as engine:
            ended = [future.result() for _, future in engine.done(abs, deque([-3]), say)]
        assert ended == [3]
        assert said[0].startswith(f"no workers: waiting until one connects to {cluster.scheduler_address}; ")


def test_what_nobody_listens_to_is_lost():
    tell("into the void")
    heard = []
    with told_to(heard.append):
        tell("a word")
    tell("too late")
    assert heard == ["a word"]
    assert worker_name().rpartition(":")[2].isdigit()


def test_results_come_in_the_order_of_the_tasks_with_what_each_said(tasks):
    kept = Kept()
    assert side_by_side(tasks.square_aloud, [3, 1, 2], 2, kept) == [9, 1, 4]
    assert sorted(kept.lines) == ["1 squared", "2 squared", "3 squared"]


def test_the_first_error_is_raised_once_all_others_are_done(tasks):
    kept = Kept()
    with pytest.raises(UnknownName) as caught:
        side_by_side(tasks.square_aloud, [1, -2, -1, 2], 2, kept)
    assert caught.value.name == "-2"
    assert sorted(kept.lines) == ["1 squared", "2 squared"]


def test_a_worker_that_dies_is_told(tasks):
    with pytest.raises(WorkerDied, match="killed by signal 9"):
        side_by_side(tasks.die_with, [9], 1, Kept())
