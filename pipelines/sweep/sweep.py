"""Replay one recording with every combination of some settings; stages that settings share are done once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from quadlog.errors import AlreadyExists, CannotWrite, QuadlogError, RunExists
from quadlog.pipelines.batch.batch import BatchOutcome, ReplayAll, open_workers
from quadlog.pipelines.batch.plan import Planned, existing_runs
from quadlog.pipelines.batch.progress import BatchLines
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayOutcome, ReplayRequest
from quadlog.pipelines.stages.resume import find_reusable, refuse_another, stage_keys
from quadlog.pipelines.stages.stage import stages_for
from quadlog.pipelines.sweep.grid import Combination
from quadlog.pipelines.sweep.sharing import Shared, made_in, parts, shared_stages, take_over
from quadlog.results.page.runs_page import write_sweep_page
from quadlog.results.places import place_of_new
from quadlog.results.record import InputRecord, describe_input, is_finished
from quadlog.results.stage_marks import read_marks
from quadlog.results.sweep import PAGE, TABLE, SweepRow, write_sweep_table
from quadlog.storage.atomic_write import new_folder

_FLAGS = "--force to replace it or --resume to continue"


@dataclass(frozen=True, slots=True)
class SweepRequest:
    """A recording, the grid of its replays and the folder of their runs. options: of all, but for the seed."""

    recording: Path
    output: Path
    grid: Sequence[Combination]
    options: ReplayOptions
    existing: Existing
    command: tuple[str, ...]


def sweep(request: SweepRequest, jobs: int, scheduler: str | None, progress: BatchLines) -> list[SweepRow]:
    """Replay every combination and write the table and the page of all; returns the rows of the table.

    An error is the outcome of its combination, or of all that share the stage it met. Raises, before anything is
    written, RecordingNotFound, AlreadyExists, CannotWrite and RunOfAnother; ClusterUnusable and VersionsDiffer.
    """
    described = describe_input(request.recording)
    batch = [Planned(_request_of(request, each, described), described.size_bytes) for each in request.grid]
    _check_output(request, batch, described)
    with open_workers(batch, jobs, scheduler, progress, repeats=False) as replay_all:
        outcomes = _Sweeping(batch, described.identity).run(replay_all)
    rows = [_row(*each) for each in zip(request.grid, outcomes, strict=True)]
    with new_folder(request.output):  # not there where every run failed before its folder
        write_sweep_table(request.output, rows)
        write_sweep_page(request.output)
    return rows


def outcome_of(rows: Sequence[SweepRow], request: SweepRequest) -> BatchOutcome:
    """The exit code and the lines about failures, as those of a batch."""
    runs = [ReplayOutcome(Path(row.run), request.output / row.run, row.exit_code, row.reason) for row in rows]
    return BatchOutcome(tuple(runs))


def _row(combination: Combination, outcome: ReplayOutcome) -> SweepRow:
    metrics = {name: float(metric["value"]) for name, metric in outcome.metrics.items()}
    exit_code = int(outcome.exit_code)
    return SweepRow(combination.values, combination.seed, combination.name, exit_code, outcome.reason, metrics)


def _request_of(request: SweepRequest, combination: Combination, described: InputRecord) -> ReplayRequest:
    return ReplayRequest(
        recording=request.recording,
        run=request.output / combination.name,
        config=combination.configured.config,
        options=replace(request.options, seed=combination.seed),
        existing=request.existing,
        command=request.command,
        notes=combination.configured.notes,
        draws=False,
        described=described,
    )


def _check_output(request: SweepRequest, batch: Sequence[Planned], described: InputRecord) -> None:
    """Raises AlreadyExists, CannotWrite and RunOfAnother where the sweep would replace what it must not."""
    output = request.output
    if output.exists() and not output.is_dir():
        raise CannotWrite(output, "is no folder")
    if (output / PAGE).exists() and not (output / TABLE).exists():
        raise CannotWrite(output / PAGE, f"is no page of a sweep, and {TABLE} is missing; choose another folder by -o")
    there = existing_runs(batch)
    if request.existing is Existing.REFUSE:
        if (output / TABLE).exists():
            raise AlreadyExists(output / TABLE, _FLAGS)
        if there:
            raise RunExists(min(there))
    if request.existing is Existing.RESUME:
        for each in batch:
            if each.request.run in there:
                refuse_another(each.request, described)


class _Sweeping:
    """The runs of a sweep while they are replayed. begun: whose folders hold results of this sweep."""

    def __init__(self, batch: Sequence[Planned], identity: str) -> None:
        self._batch, self._identity = batch, identity
        self._stages = stages_for(batch[0].request.options.until)
        self._shared = shared_stages([stage_keys(each.request, identity) for each in batch])
        self._begun: set[int] = set()
        self._failed: dict[int, ReplayOutcome] = {}
        self._base: dict[int, Shared] = {}

    def run(self, replay_all: ReplayAll) -> list[ReplayOutcome]:
        """Shared stages first, each by its leader; then all runs to their end, each from the stages it shares."""
        for part in parts(self._shared):
            self._do_shared(part, replay_all)
        todo = {number: self._prepared(number) for number in range(len(self._batch))}
        ready = {number: planned for number, planned in todo.items() if planned is not None}
        ended = dict(zip(ready, replay_all([*ready.values()]), strict=True)) if ready else {}
        return [ended[number] if number in ended else self._failed[number] for number in todo]

    def _do_shared(self, part: Sequence[Shared], replay_all: ReplayAll) -> None:
        todo = [(each, self._prepared(each.leader, self._stages[each.depth - 1].name)) for each in part]
        ready = [(shared, planned) for shared, planned in todo if planned is not None]
        outcomes = replay_all([planned for _, planned in ready]) if ready else ()
        for (shared, _), outcome in zip(ready, outcomes, strict=True):
            for member in shared.members:
                self._base[member] = shared
                if outcome.failed:
                    self._failed[member] = replace(outcome, run=self._batch[member].request.run)

    def _prepared(self, number: int, pause_after: str | None = None) -> Planned | None:
        """A run as it is replayed next, its folder with the stages that another has done for it; None if failed."""
        if number in self._failed:
            return None
        planned, base = self._batch[number], self._base.get(number)
        request = planned.request
        if base is not None and base.leader != number:
            try:
                self._take_over(number, base)
            except QuadlogError as error:
                self._failed[number] = ReplayOutcome.of_failure(request, str(error))
                return None
        forced = request.existing is Existing.FORCE and number not in self._begun
        self._begun.add(number)
        existing = Existing.FORCE if forced else Existing.RESUME  # what must not be replaced was refused before
        return replace(planned, request=replace(request, existing=existing, pause_after=pause_after))

    def _take_over(self, number: int, base: Shared) -> None:
        """Take the shared stages over unless the run's folder has them, from this sweep or from one that is resumed."""
        request, source = self._batch[number].request, made_in(self._batch[base.leader].request.run)
        may_have, place = request.existing is Existing.RESUME or number in self._begun, made_in(request.run)
        wanted = min(base.depth, len(read_marks(source)))
        if may_have and place.is_dir() and len(find_reusable(replace(request, run=place), self._identity)) >= wanted:
            return
        if not may_have and is_finished(place):
            place = place_of_new(request.run)
        take_over(source, place, self._stages[: base.depth], request.config)
        self._begun.add(number)
