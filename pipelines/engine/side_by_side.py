"""The same call for each of many tasks, on several processes of this machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from typing import TypeVar

from quadlog.errors import QuadlogError
from quadlog.pipelines.engine.local_pool import LocalPool
from quadlog.pipelines.progress import Kept, Progress

Task = TypeVar("Task")
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
