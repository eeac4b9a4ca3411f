from __future__ import annotations

from collections import deque

import pytest

from quadlog.pipelines.engine.engine import Engine, open_engine
from quadlog.pipelines.engine.here import Here
from quadlog.pipelines.engine.telling import tell, worker_name


@pytest.mark.parametrize("place", ["here", "processes", "cluster"])
def test_every_engine_does_each_task_once_and_hears_what_is_told(tasks, request, place):
    heard = []
    scheduler = request.getfixturevalue("cluster").scheduler_address if place == "cluster" else None
    with open_engine(2 if place == "processes" else 1, scheduler, heard.append) as engine:
        done = {task[0]: future.result() for task, future in engine.done(tasks.talk, deque([[n] for n in range(9)]))}
    assert done == dict.fromkeys(range(9), 1)
    if place != "cluster":  # whose events come when they come
        assert sorted(heard) == list(range(9))


def test_no_more_tasks_are_given_out_than_there_is_room_for():
    given, most = [], []

    class Watched(Here):
        def submit(self, fn, /, *args, **kwargs):
            most.append(len(given) - len(taken))
            given.append(args)
            return super().submit(fn, *args, **kwargs)

    taken, todo = [], deque(range(20))
    for task, _ in Engine(Watched(), lambda: 1, lambda: 3, lambda: None).done(abs, todo):
        taken.append(task)
        if task == 4:
            todo.appendleft(99)
    assert sorted(taken) == [*range(20), 99]
    assert taken.index(99) < taken.index(10)
    assert max(most) < 3


def test_an_error_here_is_the_futures_and_an_interrupt_is_not():
    def interrupt():
        raise KeyboardInterrupt

    here = Here()
    assert type(here.submit(int, "x").exception()) is ValueError
    with pytest.raises(KeyboardInterrupt):
        here.submit(interrupt)


def test_what_nobody_listens_to_is_lost():
    tell("into the void")
    heard = []
    Here(heard.append).submit(tell, "a word")
    tell("too late")
    assert heard == ["a word"]
    assert worker_name().rpartition(":")[2].isdigit()
