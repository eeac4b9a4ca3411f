"""Recordings of a batch and their run folders, whose names stay when recordings are added or removed."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from itertools import chain, count
from pathlib import Path
from typing import Any

from quadlog.config.schema import Config
from quadlog.errors import CannotWrite, NotARun, RunOfAnother
from quadlog.pipelines.replay import finished_outcome, refuse_another, reusable_stages
from quadlog.pipelines.request import Existing, ReplayOptions, ReplayRequest
from quadlog.recordings.file_names import stem
from quadlog.recordings.find import find_recordings
from quadlog.results.find_runs import is_absent, run_name, run_names
from quadlog.results.record import input_bytes, is_finished, location_of, own_files, read_object


def kept_names(recordings: Sequence[Path], output: Path) -> list[str]:
    """A folder name for each recording: that of its run in the output folder, else what `run_names` gives.

    Only runs whose names begin as those of a recording are read.
    """
    begins = tuple(run_name(path.resolve().name if path.is_dir() else stem(path)).casefold() for path in recordings)
    there = {entry.name for entry in output.iterdir()} if output.is_dir() else set()
    runs = {_recording_of(output / name): name for name in sorted(there) if name.casefold().startswith(begins)}
    kept = [runs.get(location_of(recording)) for recording in recordings]
    taken, names = {name.casefold() for name in kept if name is not None}, []
    others = {name.casefold() for name in there}
    for fresh, own in zip(run_names(recordings), kept, strict=True):
        wanted = chain([fresh], (f"{fresh}-{number}" for number in count(2)))
        free = (name for name in wanted if name.casefold() not in taken)
        # A folder of that very name is for the caller to refuse or to replace; one of another case is in the way.
        names.append(own or next(name for name in free if name in there or name.casefold() not in others))
        taken.add(names[-1].casefold())
    return names


def _recording_of(run: Path) -> str | None:
    """The place of the recording whose finished run this is, as its record has it."""
    with suppress(NotARun):
        recorded = read_object(run, "run.json", "").get("input")
        return str(recorded.get("path")) if isinstance(recorded, dict) else None
    return None


def plan_batch(
    arguments: Sequence[str],
    output: Path,
    config: Config,
    options: ReplayOptions,
    existing: Existing,
    command: tuple[str, ...],
    notes: tuple[str, ...] = (),
    plots: bool = True,
) -> list[ReplayRequest]:
    """What would run, and where to; nothing is written. notes, plots: see ReplayRequest.

    Raises RecordingNotFound for an argument without recordings, CannotWrite for an output that is no folder.
    """
    recordings = find_recordings(arguments)
    if output.exists() and not output.is_dir():
        raise CannotWrite(output, "is no folder")
    how: dict[str, Any] = {"existing": existing, "command": command, "notes": notes, "plots": plots}
    return [
        ReplayRequest(path, output / name, config, options, size_bytes=input_bytes(own_files(path)), **how)
        for path, name in zip(recordings, kept_names(recordings, output), strict=True)
    ]


def preview_batch(batch: Sequence[ReplayRequest]) -> list[dict[str, Any]]:
    """A row of `--dry-run --json` for each recording: run, resume (with stages to reuse), replace, skip or refuse.

    Only the recordings of runs that are resumed are looked at.
    """
    there, rows = existing_runs(batch), []
    for each in batch:
        action, reused = _preview(each, each.run in there)
        where = {"action": action, "recording": str(each.recording), "run": str(each.run)}
        rows.append(where | {"size_bytes": each.size_bytes, "reused_stages": list(reused)})
    return rows


def existing_runs(batch: Sequence[ReplayRequest]) -> set[Path]:
    """Run folders of the batch that exist and hold more than a failure; lists each output folder once."""
    runs = {each.run for each in batch}
    there = {entry for folder in {run.parent for run in runs} if folder.is_dir() for entry in folder.iterdir()} & runs
    return {run for run in there if not run.is_dir() or any(not is_absent(entry.name) for entry in run.iterdir())}


def _preview(request: ReplayRequest, is_there: bool) -> tuple[str, Sequence[str]]:
    """What would be done, and the stages that would be reused."""
    if not is_there:
        reused = reusable_stages(request) if request.existing is Existing.RESUME else ()
        return "resume" if reused else "run", reused
    if request.existing is not Existing.RESUME:
        return "replace" if request.existing is Existing.FORCE else "refuse", ()
    if is_finished(request.run):
        if finished_outcome(request) is not None:
            return "skip", ()
        try:
            refuse_another(request)
        except RunOfAnother:
            return "refuse", ()
    return "resume", reusable_stages(request)
