"""Replay one recording with every combination of some settings; stages that settings share are done once."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from quadlog.errors import AlreadyExists, CannotWrite, RunExists
from quadlog.pipelines.batch.batch import BatchOutcome, ReplayAll, open_workers
from quadlog.pipelines.batch.plan import Planned, existing_runs
from quadlog.pipelines.batch.progress import BatchLines
from quadlog.pipelines.replay import planned_keys, refuse_another
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayOutcome, ReplayRequest
from quadlog.pipelines.store import Store
from quadlog.pipelines.sweep.grid import Combination
from quadlog.results.page.runs_page import write_sweep_page
from quadlog.results.record import input_bytes, own_files
from quadlog.results.studies.sweep import PAGE, TABLE, SweepRow, write_sweep_table
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
    size_bytes = input_bytes(own_files(request.recording))
    batch = [Planned(_request_of(request, each), size_bytes) for each in request.grid]
    _check_output(request, batch)
    with open_workers(batch, jobs, scheduler, progress, repeats=False) as replay_all:
        outcomes = _replay_all(batch, request.existing, replay_all)
    rows = [_row(*each) for each in zip(request.grid, outcomes, strict=True)]
    Store(request.output).trim({key for each in batch for key in planned_keys(each.request).values()})
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


def _request_of(request: SweepRequest, combination: Combination) -> ReplayRequest:
    return ReplayRequest(
        recording=request.recording,
        run=request.output / combination.name,
        config=combination.configured.config,
        options=replace(request.options, seed=combination.seed),
        existing=request.existing,
        command=request.command,
        notes=combination.configured.notes,
        draws=False,
    )


def _check_output(request: SweepRequest, batch: Sequence[Planned]) -> None:
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
                refuse_another(each.request)


def shared_stages(keys: Sequence[Mapping[str, str]]) -> Iterator[list[tuple[int, str]]]:
    """(run, stage) for each result that several runs need before they part, given the keys of their stages in order.

    Those of a list can be done at the same time; those of later ones may need them.
    """
    names = list(keys[0])
    for depth, name in enumerate(names):
        runs: dict[str, list[int]] = defaultdict(list)
        for number, chain in enumerate(keys):
            runs[chain[name]].append(number)
        after = names[depth + 1 : depth + 2]
        shared = [
            (members[0], name)
            for members in runs.values()
            if len(members) > 1 and (not after or len({keys[member][after[0]] for member in members}) > 1)
        ]
        if shared:
            yield shared


def _replay_all(batch: Sequence[Planned], existing: Existing, replay_all: ReplayAll) -> Sequence[ReplayOutcome]:
    """Shared stages first, each once; then all runs, which take them from the store."""
    keys = [planned_keys(each.request) for each in batch]
    store, failed = Store(batch[0].request.run.parent), dict[str, ReplayOutcome]()
    if existing is Existing.FORCE:
        store.forget({key for chain in keys for key in chain.values()})
        batch = [replace(each, request=replace(each.request, existing=Existing.REPLACE)) for each in batch]
    for wave in shared_stages(keys):
        todo = [
            (number, name)
            for number, name in wave
            if not store.has(keys[number][name]) and failed.keys().isdisjoint(keys[number].values())
        ]
        paused = [
            replace(batch[number], request=replace(batch[number].request, pause_after=name)) for number, name in todo
        ]
        for (number, name), outcome in zip(todo, replay_all(paused) if paused else (), strict=True):
            if outcome.failed:
                failed[keys[number][name]] = outcome
    # What all need that share it has failed for all of them.
    ended = {
        number: replace(failed[key], run=batch[number].request.run)
        for number, chain in enumerate(keys)
        for key in chain.values()
        if key in failed
    }
    rest = [number for number in range(len(batch)) if number not in ended]
    ended |= zip(rest, replay_all([batch[number] for number in rest]) if rest else (), strict=True)
    return [ended[number] for number in range(len(batch))]
