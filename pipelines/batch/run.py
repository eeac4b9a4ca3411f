"""Run a batch: hand out tasks, collect outcomes, and retry those of killed workers."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import CancelledError, Future
from typing import Any

from quadlog.errors import ClusterUnusable, VersionsDiffer, WorkerDied
from quadlog.pipelines.batch.progress import BatchCounts, BatchProgress
from quadlog.pipelines.batch.task import BatchAnswer, BatchTask, out_of_memory_words, peak_words, replay_task
from quadlog.pipelines.executor.executor import Engine
from quadlog.pipelines.executor.machine import is_out_of_memory
from quadlog.pipelines.request import GOES_ON, ReplayOutcome
from quadlog.results.stages import reused_words


class BatchRun:
    """A running batch; outcomes: by the recordings' numbers. halted: why no more is started, empty while it goes on."""

    def __init__(
        self,
        tasks: Sequence[BatchTask],
        progress: BatchProgress,
        halted: str = "",
        said: set[str] | None = None,
    ) -> None:
        """tasks: in the order of their start. halted: of an earlier batch on the same workers.

        said: warnings that are not repeated, where all tasks are of one recording.
        """
        self.outcomes: dict[int, ReplayOutcome] = {}
        self._todo, self._progress = deque(tasks), progress
        self._tally = BatchCounts(len(tasks), sum(task.size_bytes for task in tasks))
        self._died: set[int] = set()
        self._peak_mb: dict[int, float] = {}
        self.halted = halted
        self._said = said

    def go(self, engine: Engine) -> None:
        """Run until every task has an outcome. Ctrl-C is reported with the number done, and raised again."""
        self._progress.expect(self._tally, engine.workers())
        tasks = list(self._todo)
        if self.halted:
            self._todo.clear()
        try:
            for task, future in engine.done(replay_task, self._todo, self._progress.say):
                self._take(task, future, engine)
        except (ClusterUnusable, VersionsDiffer) as error:
            self._halt(str(error), engine)
        except KeyboardInterrupt:
            self._progress.say(f"interrupted with {self._tally.done} of {self._tally.recordings} recordings done")
            raise
        for task in tasks:
            if task.number not in self.outcomes:
                self.outcomes[task.number] = self._halted_answer(task).outcome

    def hear(self, step: Mapping[str, Any]) -> None:
        """A message from a worker. Its peak memory is kept in case it is killed."""
        self._peak_mb[step["number"]] = step["peak_memory_mb"]
        self._progress.hear(step)

    def _take(self, task: BatchTask, future: Future[BatchAnswer], engine: Engine) -> None:
        """Take the outcome of a task that has ended, or queue the task again."""
        try:
            answer = future.result()
        except CancelledError:
            self._halt("the scheduler has ended, or dropped what it was given", engine)
            answer = self._halted_answer(task)
        except WorkerDied as error:
            if self.halted:
                answer = self._halted_answer(task)
            elif task.number in self._died or engine.tries == 1:
                answer = _failed(task, self._death_words(task, error, engine))
            else:
                self._died.add(task.number)
                self._todo.appendleft(task)
                return
        except Exception as error:
            answer = self._answer_of(task, error, engine)
        self._count(task, answer)
        if answer.disk_full:
            self._halt(f"disk full ({answer.disk_full.removesuffix(f'; {GOES_ON}')})", engine)

    def _answer_of(self, task: BatchTask, error: Exception, engine: Engine) -> BatchAnswer:
        """The answer for an error of the executor; errors that would meet every recording stop the batch."""
        if is_out_of_memory(error):
            return _failed(task, out_of_memory_words(self._peak_mb.get(task.number)))
        if isinstance(error, (ClusterUnusable, VersionsDiffer)):
            self._halt(str(error), engine)
        elif isinstance(error, ImportError):
            self._halt(f"a worker cannot load quadlog: {error}", engine)
        else:
            return _failed(task, f"a bug in quadlog: {type(error).__name__}: {error}")
        return self._halted_answer(task)

    def _count(self, task: BatchTask, answer: BatchAnswer) -> None:
        outcome = answer.outcome
        self.outcomes[task.number] = outcome
        self._peak_mb.pop(task.number, None)
        self._tally.count(task.size_bytes, outcome.failed, outcome.cost.get("wall_s"))
        for warning in answer.warnings:
            if self._said is None or warning not in self._said:
                self._progress.say(f"{outcome.run.name}: {warning}")
        if self._said is not None:
            self._said.update(answer.warnings)
        pause = task.request.pause_after
        done = "done" if pause is None else f"{pause} is done for all that share it"
        words = [outcome.reason or done]
        if outcome.reused:
            words.append(reused_words(outcome.reused, task.request.options.until))
        self._progress.finish(outcome.run.name, "; ".join(words))

    def _halt(self, reason: str, engine: Engine) -> None:
        """Stop the batch, with one line for the user."""
        if not self.halted:
            self.halted = reason
            self._progress.say(f"stopping: {reason}; {GOES_ON}")
            self._todo.clear()
            engine.stop()

    def _halted_answer(self, task: BatchTask) -> BatchAnswer:
        begun = "stopped" if task.number in self._peak_mb else "not started"
        return _failed(task, f"{begun}: {self.halted}; {GOES_ON}")

    def _death_words(self, task: BatchTask, error: WorkerDied, engine: Engine) -> str:
        again = ", and so was the next one" if engine.tries > 1 else ""
        peak = peak_words(self._peak_mb.get(task.number))
        return f"its worker was {error.how}{again}{peak}; out of memory is the usual cause; {GOES_ON}"


def _failed(task: BatchTask, reason: str) -> BatchAnswer:
    return BatchAnswer(ReplayOutcome.of_failure(task.request, reason))
