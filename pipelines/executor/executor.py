"""One interface to wherever tasks run: this process, processes on this machine, or a Dask cluster."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, as_completed, wait
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from quadlog.errors import QuadlogError
from quadlog.pipelines.executor.local_pool import LocalPool
from quadlog.pipelines.executor.progress import Kept, Listener, Progress

LOOK_AGAIN_S = 5.0
"""So often a cluster is asked whether it has grown while no task ends."""

Task = TypeVar("Task")


@dataclass(frozen=True, slots=True)
class Engine:
    """An executor, and what is different from one to another.

    workers: how many there are, and room: how many tasks they are to have, both of which may change; 0 without
    workers. stop: end what runs and take no more. tries: how often a task is given out whose worker dies. greeting: a
    line for the user. address: of the scheduler that workers connect to.
    """

    executor: Executor
    workers: Callable[[], int]
    room: Callable[[], int]
    stop: Callable[[], None]
    tries: int = 1
    greeting: str = ""
    address: str = ""

    def done(
        self, call: Callable[[Task], Any], todo: deque[Task], say: Callable[[str], None]
    ) -> Iterator[tuple[Task, Future[Any]]]:
        """Each task with its future when it is done, in the order they end.

        Tasks are taken from the left of `todo` as there is room, and may be put there or taken away meanwhile:
        thousands of them cost no more than their place in it. say: is told when all workers have gone, which is waited
        out, since a cluster's may come and go, and when there are some again.
        """
        running: dict[Future[Any], Task] = {}
        waiting = False
        while todo or running:
            room = self.room()
            if waiting != (room == 0):
                waiting = not waiting
                say(self._waiting_words if waiting else "a worker has connected: going on")
            while todo and len(running) < max(1, room):
                task = todo.popleft()
                running[self.executor.submit(call, task)] = task
            for future in wait(running, LOOK_AGAIN_S, FIRST_COMPLETED).done:
                yield running.pop(future), future

    @property
    def _waiting_words(self) -> str:
        return f"no workers: waiting until one connects to {self.address}; Ctrl-C stops, --resume goes on"


@contextmanager
def open_engine(jobs: int, scheduler: str | None, listener: Listener) -> Iterator[Engine]:
    """As many processes as jobs, also for one; with the address of a scheduler, the cluster that it serves.

    A task never runs in this process, which therefore outlives whatever kills the task's. listener: hears what tasks
    tell. Raises what `open_cluster` raises. After an error or Ctrl-C nothing goes on.
    """
    if scheduler is not None:
        from quadlog.pipelines.executor.dask_cluster import open_cluster

        with open_cluster(scheduler, listener) as cluster:
            greeting = cluster.greeting
            yield Engine(cluster, cluster.workers, cluster.room, cluster.stop, greeting=greeting, address=scheduler)
    else:
        with LocalPool(jobs, listener=listener) as pool:
            yield Engine(pool, lambda: jobs, lambda: 2 * jobs, pool.terminate_workers, tries=2)


Result = TypeVar("Result")


def side_by_side(
    call: Callable[[Task, Progress], Result], tasks: Sequence[Task], workers: int, progress: Progress
) -> list[Result]:
    """call(task, progress) for each, as many at a time as there are workers; results in the order of the tasks.

    What a call says is said when it ends. The first error, in that order, is raised once all others are done; that of
    a worker that dies, WorkerDied, at once.
    """
    results: dict[int, Result] = {}
    failures: dict[int, QuadlogError] = {}
    with LocalPool(workers) as pool:
        futures = {pool.submit(_call, call, task): number for number, task in enumerate(tasks)}
        for future in as_completed(futures):
            number, (result, lines) = futures[future], future.result()
            for line in lines:
                progress.say(line)
            if isinstance(result, QuadlogError):
                failures[number] = result
            else:
                results[number] = result
            progress.advance()
    if failures:
        raise failures[min(failures)]
    return [results[number] for number in range(len(tasks))]


def _call(call: Callable[[Task, Progress], Result], task: Task) -> tuple[Result | QuadlogError, tuple[str, ...]]:
    """In the other process: the result or why there is none, and what it had to say."""
    kept = Kept()
    try:
        return call(task, kept), tuple(kept.lines)
    except QuadlogError as error:
        return error, tuple(kept.lines)
