"""What a batch would do, before it does anything: which recordings, where to, what is there, how long it may take."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from quadlog.config import Config
from quadlog.errors import CannotWrite, QuadlogError, RunOfAnother
from quadlog.pipelines.finished_runs import outcome_there, refuse_another
from quadlog.pipelines.kept_names import kept_names
from quadlog.pipelines.replay import Existing, ReplayOptions, ReplayRequest, reusable_stages
from quadlog.recordings.find import find_recordings
from quadlog.results.files import is_part
from quadlog.results.record import describe_input, input_bytes, own_files
from quadlog.results.run_folder import read_run_json

SAMPLED_RUNS = 64
"""So many finished runs are asked how long others take."""


@dataclass(frozen=True, slots=True)
class Planned:
    """A recording, where its run goes, and its size."""

    request: ReplayRequest
    size_bytes: int


@dataclass(frozen=True, slots=True)
class Previewed:
    """What would be done with a recording: run, resume (with what is reused), replace, skip or refuse.

    expected_s: how long that takes one worker; 0 for nothing, None when nobody knows.
    """

    planned: Planned
    action: str
    reused: tuple[str, ...] = ()
    expected_s: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """One row of `--dry-run --json`."""
        request = self.planned.request
        where = {"action": self.action, "recording": str(request.recording), "run": str(request.run)}
        size = {"size_bytes": self.planned.size_bytes, "expected_s": self.expected_s}
        return where | size | {"reused_stages": list(self.reused)}


def plan_batch(
    arguments: Sequence[str],
    output: Path,
    config: Config,
    options: ReplayOptions,
    existing: Existing,
    command: tuple[str, ...],
    notes: tuple[str, ...] = (),
) -> list[Planned]:
    """What would run, and where to; nothing is written. notes: see ReplayRequest.

    Raises RecordingNotFound for an argument without recordings, CannotWrite for an output that is no folder.
    """
    recordings = find_recordings(arguments)
    if output.exists() and not output.is_dir():
        raise CannotWrite(output, "is no folder")
    requests = [
        ReplayRequest(recording, output / name, config, options, existing, command, notes=notes)
        for recording, name in zip(recordings, kept_names(recordings, output), strict=True)
    ]
    return [Planned(request, _size(request.recording)) for request in requests]


def preview_batch(batch: Sequence[Planned]) -> list[Previewed]:
    """What would be done with each, and for how long; only recordings that have a run folder are looked into."""
    there = existing_runs(batch)
    rates = {folder: _seconds_per_byte(folder, batch) for folder in {each.request.run.parent for each in batch}}
    return [_preview(each, each.request.run in there, rates[each.request.run.parent]) for each in batch]


def total_s(previewed: Iterable[Previewed], jobs: int) -> float | None:
    """How long all take so many workers, the largest first; None when that of one is unknown."""
    expected = [each.expected_s for each in previewed]
    known = [each for each in expected if each is not None]
    if len(known) < len(expected):
        return None
    free_s = [0.0] * max(1, min(jobs, len(known)))
    for seconds in sorted(known, reverse=True):
        free_s[free_s.index(min(free_s))] += seconds
    return max(free_s)


def existing_runs(batch: Sequence[Planned]) -> set[Path]:
    """Run folders of the batch that are there and hold anything; one look into each output folder finds them."""
    runs = {each.request.run for each in batch}
    there = {entry for folder in {run.parent for run in runs} if folder.is_dir() for entry in folder.iterdir()} & runs
    return {run for run in there if not run.is_dir() or any(not is_part(entry.name) for entry in run.iterdir())}


def _preview(planned: Planned, is_there: bool, seconds_per_byte: float | None) -> Previewed:
    whole_s = None if seconds_per_byte is None else planned.size_bytes * seconds_per_byte
    existing = planned.request.existing
    if not is_there:
        return Previewed(planned, "run", expected_s=whole_s)
    if existing is Existing.REFUSE:
        return Previewed(planned, "refuse", expected_s=0.0)
    if existing is Existing.FORCE:
        return Previewed(planned, "replace", expected_s=whole_s)
    if (planned.request.run / "run.json").is_file():
        described = describe_input(planned.request.recording)
        if outcome_there(planned.request, described) is not None:
            return Previewed(planned, "skip", expected_s=0.0)
        try:
            refuse_another(planned.request, described)
        except RunOfAnother:
            return Previewed(planned, "refuse", expected_s=0.0)
    return Previewed(planned, "resume", reusable_stages(planned.request), whole_s)


def _seconds_per_byte(folder: Path, batch: Sequence[Planned]) -> float | None:
    """By the records of some finished runs in the output folder that went as far as these are to go."""
    until = batch[0].request.options.until
    seconds, size_bytes = 0.0, 0
    for record in islice(_records(folder), SAMPLED_RUNS):
        try:
            if record["options"]["until"] == until:
                took_s = record["startup_s"] + sum(stage["seconds"] for stage in record["stages"])
                seconds, size_bytes = seconds + took_s, size_bytes + record["input"]["size_bytes"]
        except (KeyError, TypeError):
            continue  # not a replay's
    return seconds / size_bytes if size_bytes else None


def _records(folder: Path) -> Iterator[dict[str, Any]]:
    for run in folder.iterdir() if folder.is_dir() else ():
        with suppress(QuadlogError):  # no run, or one of another format
            yield read_run_json(run)


def _size(recording: Path) -> int:
    return input_bytes(own_files(recording))
