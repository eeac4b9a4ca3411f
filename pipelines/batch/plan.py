"""Recordings of a batch and their run folders, whose names stay when recordings are added or removed."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from quadlog.config.schema import Config
from quadlog.errors import CannotWrite, NotARun, QuadlogError, RunOfAnother, UnknownRunFormat
from quadlog.pipelines.replay import reusable_stages
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayRequest
from quadlog.pipelines.stages.resume import outcome_there, refuse_another
from quadlog.recordings.file_names import stem
from quadlog.recordings.find import find_recordings
from quadlog.results.find_runs import run_name, run_names
from quadlog.results.record import RunRecord, describe_input, input_bytes, own_files, read_record
from quadlog.storage.atomic_write import is_part


def kept_names(recordings: Sequence[Path], output: Path) -> list[str]:
    """A folder name for each recording: that of its run in the output folder, else what `run_names` gives.

    Runs are read only where several folders could belong to a recording.
    """
    fresh = run_names(recordings)
    there = [entry.name for entry in output.iterdir()] if output.is_dir() else []
    kept = _kept(recordings, fresh, output, there)
    taken = {name.casefold() for name in kept.values()}
    names = []
    for number, name in enumerate(fresh):
        chosen = kept.get(number) or _free(name, taken)
        taken.add(chosen.casefold())
        names.append(chosen)
    return names


def _kept(recordings: Sequence[Path], fresh: Sequence[str], output: Path, there: Iterable[str]) -> dict[int, str]:
    """Index of a recording -> name of the run it has."""
    families: dict[str, list[str]] = {}
    for name in there:
        families.setdefault(_family(name), []).append(name)
    alike = Counter(_family(name) for name in fresh)
    kept: dict[int, str] = {}
    given: set[str] = set()
    runs: dict[str, Mapping[str, str]] = {}
    for number, (recording, name) in enumerate(zip(recordings, fresh, strict=True)):
        family = _family(name)
        names = families.get(family, [])
        if not names or (alike[family] == 1 and names == [name]):
            continue
        if family not in runs:
            runs[family] = {_place(path): each for each in sorted(names) if (path := _recording_of(output / each))}
        mine = runs[family].get(_place(recording))
        if mine is not None and mine not in given:
            kept[number] = mine
            given.add(mine)
    return kept


def _family(name: str) -> str:
    """The common key of all names a recording's run may have: the same for `walk`, `walk.bag` and `walk.bag-2-2`."""
    plain = re.sub(r"(-[0-9]{1,6})+$", "", name)
    return run_name(stem(Path(plain if stem(Path(plain)) != plain else name))).casefold()


def _free(name: str, taken: set[str]) -> str:
    free, number = name, 2
    while free.casefold() in taken:
        free = f"{name}-{number}"
        number += 1
    return free


def _recording_of(run: Path) -> str | None:
    try:
        return read_record(run).input.path
    except (NotARun, UnknownRunFormat):
        return None


def _place(recording: Path | str) -> str:
    """The recording's absolute path, or its URL."""
    text = str(recording)
    return text if "://" in text else str(Path(text).absolute())


SAMPLED_RUNS = 64
"""Number of finished runs that an expected duration is estimated from."""


@dataclass(frozen=True, slots=True)
class Planned:
    """A recording, where its run goes, and its size."""

    request: ReplayRequest
    size_bytes: int


@dataclass(frozen=True, slots=True)
class Previewed:
    """What would be done with a recording: run, resume (with the stages reused), replace, skip or refuse.

    expected_s: duration on one worker; 0 when nothing is done, None when unknown.
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
    plots: bool = True,
) -> list[Planned]:
    """What would run, and where to; nothing is written. notes, plots: see ReplayRequest.

    Raises RecordingNotFound for an argument without recordings, CannotWrite for an output that is no folder.
    """
    recordings = find_recordings(arguments)
    if output.exists() and not output.is_dir():
        raise CannotWrite(output, "is no folder")
    requests = [
        ReplayRequest(recording, output / name, config, options, existing, command, notes=notes, plots=plots)
        for recording, name in zip(recordings, kept_names(recordings, output), strict=True)
    ]
    return [Planned(request, _size(request.recording)) for request in requests]


def preview_batch(batch: Sequence[Planned]) -> list[Previewed]:
    """What would be done with each recording, and for how long; only those with a run folder are read."""
    there = existing_runs(batch)
    rates = {folder: _seconds_per_byte(folder, batch) for folder in {each.request.run.parent for each in batch}}
    return [_preview(each, each.request.run in there, rates[each.request.run.parent]) for each in batch]


def total_s(previewed: Iterable[Previewed], jobs: int) -> float | None:
    """Duration of all on `jobs` workers, the largest first; None when that of one is unknown."""
    expected = [each.expected_s for each in previewed]
    known = [each for each in expected if each is not None]
    if len(known) < len(expected):
        return None
    free_s = [0.0] * max(1, min(jobs, len(known)))
    for seconds in sorted(known, reverse=True):
        free_s[free_s.index(min(free_s))] += seconds
    return max(free_s)


def existing_runs(batch: Sequence[Planned]) -> set[Path]:
    """Run folders of the batch that exist and are not empty; lists each output folder once."""
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
    """From the records of finished runs in the output folder with the same --until."""
    until = batch[0].request.options.until
    seconds, size_bytes = 0.0, 0
    for record in islice(_records(folder), SAMPLED_RUNS):
        if record.options.get("until") == until:
            seconds += record.startup_s + sum(stage.seconds for stage in record.stages)
            size_bytes += record.input.size_bytes
    return seconds / size_bytes if size_bytes else None


def _records(folder: Path) -> Iterator[RunRecord]:
    for run in folder.iterdir() if folder.is_dir() else ():
        with suppress(QuadlogError):  # no run, or one of another format
            yield read_record(run)


def _size(recording: Path) -> int:
    return input_bytes(own_files(recording))
