"""Run tasks in processes on this machine or on a Dask cluster, through one interface."""

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
"""How often a cluster is asked for its size while no task ends."""

Task = TypeVar("Task")


@dataclass(frozen=True, slots=True)
class Engine:
    """An executor, with what differs between a local pool and a cluster.

    workers: number of workers; room: number of tasks to hand out at a time; both may change, and are 0 without workers.
    stop: end running tasks and take no more. tries: how often a task is started whose worker dies. greeting: a line for
    the user. address: of the scheduler that workers connect to.
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

        Tasks are taken from the left of `todo` as there is room; it may change meanwhile. A cluster without workers is
        waited for; say is called with a line when that begins and when it ends.
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
    """A pool of `jobs` processes, or the cluster of a scheduler's address.

    Tasks never run in this process, so that it survives what kills theirs. listener: called with each of their
    messages. Raises what `open_cluster` raises. After an error or Ctrl-C all tasks are stopped.
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
    """call(task, progress) for each task in parallel; results in the order of the tasks.

    Lines of a call are passed to `progress` when it ends. The first QuadlogError in that order is raised after all
    calls have ended; WorkerDied is raised at once.
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
    """In the worker: the result or the error, and the lines of its progress."""
    kept = Kept()
    try:
        return call(task, kept), tuple(kept.lines)
    except QuadlogError as error:
        return error, tuple(kept.lines)
