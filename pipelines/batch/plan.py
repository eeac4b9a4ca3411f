"""Recordings of a batch and their run folders, whose names stay when recordings are added or removed."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from quadlog.config.schema import Config
from quadlog.errors import CannotWrite, NotARun, RunOfAnother, UnknownRunFormat
from quadlog.pipelines.replay import finished_outcome, refuse_another, reusable_stages
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayRequest
from quadlog.recordings.file_names import stem
from quadlog.recordings.find import find_recordings
from quadlog.results.find_runs import is_absent, run_name, run_names
from quadlog.results.record import input_bytes, is_finished, own_files, read_record


def kept_names(recordings: Sequence[Path], output: Path) -> list[str]:
    """A folder name for each recording: that of its run in the output folder, else what `run_names` gives.

    Runs are read only where several folders could belong to a recording.
    """
    fresh = run_names(recordings)
    families = [_family(name) for name in fresh]
    there: dict[str, list[str]] = {}
    for entry in sorted(output.iterdir()) if output.is_dir() else ():
        there.setdefault(_family(entry.name), []).append(entry.name)
    alike = Counter(families)
    doubtful = {
        family for family, name in zip(families, fresh, strict=True) if alike[family] > 1 or there.get(family) != [name]
    }
    runs = {_recording_of(output / name): name for family in doubtful for name in there.get(family, ())}
    kept = [runs.get(_place(recording)) for recording in recordings]
    taken = {name.casefold() for name in kept if name is not None}
    names = []
    for name, own in zip(fresh, kept, strict=True):
        names.append(own or _free(name, taken))
        taken.add(names[-1].casefold())
    return names


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
    """The place of the recording whose finished run this is."""
    try:
        return _place(read_record(run).input.path)
    except (NotARun, UnknownRunFormat):
        return None


def _place(recording: Path | str) -> str:
    """The recording's absolute path, or its URL."""
    text = str(recording)
    return text if "://" in text else str(Path(text).absolute())


@dataclass(frozen=True, slots=True)
class Planned:
    """A recording, where its run goes, and its size."""

    request: ReplayRequest
    size_bytes: int


@dataclass(frozen=True, slots=True)
class Previewed:
    """What would be done with a recording: run, resume (with the stages reused), replace, skip or refuse."""

    planned: Planned
    action: str
    reused: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """One row of `--dry-run --json`."""
        request = self.planned.request
        where = {"action": self.action, "recording": str(request.recording), "run": str(request.run)}
        return where | {"size_bytes": self.planned.size_bytes, "reused_stages": list(self.reused)}


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
    """What would be done with each recording; only those of runs that are resumed are looked at."""
    there = existing_runs(batch)
    return [_preview(each, each.request.run in there) for each in batch]


def existing_runs(batch: Sequence[Planned]) -> set[Path]:
    """Run folders of the batch that exist and hold more than a failure; lists each output folder once."""
    runs = {each.request.run for each in batch}
    there = {entry for folder in {run.parent for run in runs} if folder.is_dir() for entry in folder.iterdir()} & runs
    return {run for run in there if not run.is_dir() or any(not is_absent(entry.name) for entry in run.iterdir())}


def _preview(planned: Planned, is_there: bool) -> Previewed:
    request = planned.request
    if not is_there:
        reused = reusable_stages(request) if request.existing is Existing.RESUME else ()
        return Previewed(planned, "resume" if reused else "run", reused)
    if request.existing is not Existing.RESUME:
        return Previewed(planned, "replace" if request.existing is Existing.FORCE else "refuse")
    if is_finished(request.run):
        if finished_outcome(request) is not None:
            return Previewed(planned, "skip")
        try:
            refuse_another(request)
        except RunOfAnother:
            return Previewed(planned, "refuse")
    return Previewed(planned, "resume", reusable_stages(request))


def _size(recording: Path) -> int:
    return input_bytes(own_files(recording))
