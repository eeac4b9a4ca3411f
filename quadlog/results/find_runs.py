"""Find runs in folders and recordings that failed, name runs and their files, and copy them from remote storage."""

from __future__ import annotations

import os
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import chain, count
from pathlib import Path
from typing import cast

from quadlog.errors import AlreadyExists, CannotWrite, ExitCode, NotARun, TooLarge, UsageError
from quadlog.recordings.file_names import stem
from quadlog.results import STAGE_FILES
from quadlog.results.tables import TABLES, has_table, read_table
from quadlog.storage.atomic_write import is_part
from quadlog.storage.remote_path import RemotePath, copy_object

FAILED = "failed.json"
"""The reason why a recording was not replayed. A folder without other files counts as absent."""
OWN_FILES = frozenset(
    [f"{name}.parquet" for name in TABLES if name != "summary"]
    + [file for files in STAGE_FILES.values() for file in files]
    + ["run.json", "config.toml", "report.html", "derived.mcap", "foxglove-layout.json", FAILED]
)
"""Files that quadlog writes into a run folder; `--force` removes only these."""
PLOTS, PICTURES = "plots", ("trajectory", "tracking_error", "uwb_error", "expanded")
"""The folder of a run's pictures, and the figures of which quadlog writes NAME.png there; others are the user's."""
OWN_PICTURES = frozenset(f"{PLOTS}/{name}.png" for name in PICTURES)

SUMMARY = "summary.parquet"
_FOLDER_TABLES = frozenset({SUMMARY, "sweep.parquet", "planners.parquet", "replans.parquet", "scenarios.parquet"})
_TAKEN = {SUMMARY, "report.html"}  # files in a folder of runs
_MAX_BYTES = 120  # file systems allow 255 bytes; temporary files need longer names


def is_absent(name: str) -> bool:
    """Whether a folder with files of such names alone counts as absent: a failure, and what was not finished."""
    return name == FAILED or is_part(name)


def run_name(name: str) -> str:
    """`name` as the name of one folder: no separator, no control character, no leading dot or dash, not too long."""
    safe = re.sub(r"^[.\-\s]+", "", re.sub(r"[/\\:\x00-\x1f\x7f]", "_", name)).rstrip()
    safe = safe.encode("utf-8", "replace")[:_MAX_BYTES].decode("utf-8", "ignore").rstrip(". ")
    if safe.casefold() in _TAKEN:
        return f"{safe}_"
    return safe or "recording"


def run_names(recordings: Sequence[Path]) -> list[str]:
    """A folder name for each recording: its stem, with its extension where two would collide.

    Recordings of the same name from different folders are numbered in the order given.
    Case is ignored, as some file systems do.
    """
    short = [run_name(path.resolve().name if path.is_dir() else stem(path)) for path in recordings]
    often, taken = Counter(name.casefold() for name in short), dict[str, str]()
    for name, path in zip(short, recordings, strict=True):
        unique = name if often[name.casefold()] == 1 else run_name(path.name)
        numbered = chain([unique], (f"{unique}-{number}" for number in count(2)))
        found = next(each for each in numbered if each.casefold() not in taken)
        taken[found.casefold()] = found
    return [*taken.values()]


_DEEPEST = 3  # runs/RECORDING, or runs/COURSE-CONTROLLER/seed-000


def find_runs(paths: Sequence[Path]) -> list[Path]:
    """The paths that are runs, and the runs in other folders, sorted by name; each run once.

    A folder with a run.json is a run, finished or not. Hidden folders and `files_beside_runs` are left out. Raises
    NotARun for a path without runs.
    """
    found, beside = dict[Path, Path](), files_beside_runs(paths)
    for path in (path for path in paths if path not in beside):
        if not path.is_dir():
            raise NotARun(path, "is no folder" if path.exists() else "no such folder")
        inside = [path] if is_run(path) else list(_runs_in(path, _DEEPEST))
        if not inside:
            raise NotARun(path, "is not a run and contains none")
        for run in inside:
            found.setdefault(run.resolve(), run)
    return list(found.values())


def files_beside_runs(paths: Sequence[Path]) -> list[Path]:
    """The plain files among the paths that lie beside a folder among them, as in a shell's `runs/*`."""
    folders = {path.parent for path in paths if isinstance(path, Path) and path.is_dir()}
    return [path for path in paths if isinstance(path, Path) and path.parent in folders and path.is_file()]


def is_run(folder: Path) -> bool:
    """Whether there is a run in this folder, finished or not."""
    return (folder / "run.json").is_file()


def run_labels(runs: Iterable[Path]) -> list[str]:
    """Short distinct names of the runs: their paths without the leading folders that all share."""
    places = [Path(os.path.abspath(run)) for run in runs]  # noqa: PTH100 - links keep the names they were given by
    if len(places) < 2:
        return [place.name for place in places]
    shared = len(Path(os.path.commonpath([place.parent for place in places])).parts)
    return [Path(*place.parts[shared:]).as_posix() for place in places]


def _runs_in(folder: Path, depth: int) -> Iterator[Path]:
    try:
        inside = sorted(entry for entry in folder.iterdir() if not entry.name.startswith(".") and entry.is_dir())
    except OSError:
        return
    for each in inside:
        if is_run(each):
            yield each
        elif depth > 1:
            yield from _runs_in(each, depth - 1)


def failed_recordings(folders: Iterable[Path]) -> dict[Path, str]:
    """Run folders that are missing because the replay failed, with the reason, by the summaries of the folders.

    A path may also be a summary.parquet, as in a shell's `runs/*`. Runs and folders without a summary have none.
    """
    failed: dict[Path, str] = {}
    for path in folders:
        folder = path.parent if path.name == SUMMARY and path.is_file() else path
        if is_run(folder) or not has_table(folder, "summary"):
            continue
        try:
            summary = read_table(folder, "summary", ["recording", "exit_code", "reason"])
        except NotARun:
            continue  # not quadlog's
        for name, code, reason in zip(summary["recording"], summary["exit_code"], summary["reason"], strict=True):
            if code == ExitCode.FAILED and name == run_name(name) and not is_run(folder / name):
                failed[folder / name] = f"{folder / name}: was not replayed: {reason}"
    return failed


RECORDS = frozenset({"run.json", "config.toml", "metrics.json"})
MEASURED = RECORDS.union(name for name in OWN_FILES if name.endswith(".parquet"))
"""Small files that describe a run; files that metrics are computed from."""
MAX_BYTES = 1 << 36
"""Of the runs that are copied."""


@contextmanager
def runs_here(
    paths: Sequence[Path], names: Collection[str]
) -> Iterator[tuple[list[Path], Callable[[Path | str], str]]]:
    """The paths, each URL replaced by a local copy of its run, or runs, with these files; copies go with the block.

    Also a function that gives a path in them as the user gave it. Raises NotARun, TooLarge, StorageFailed.
    """
    with tempfile.TemporaryDirectory(prefix="quadlog-") as scratch:
        places = ((path, Path(scratch) / str(number)) for number, path in enumerate(paths))
        here = [fetch_runs(path, place, names) if isinstance(path, RemotePath) else path for path, place in places]

        def as_given(path: Path | str) -> str:
            for local, given in zip(here, paths, strict=True):
                if isinstance(given, RemotePath) and Path(path).is_relative_to(local):
                    return "/".join([str(given).rstrip("/"), *Path(path).relative_to(local).parts])
            return str(path)

        yield here, as_given


def fetch_runs(remote: RemotePath, scratch: Path, names: Collection[str]) -> Path:
    """Copy these files of a run, or of a folder of runs with its summary, to a new folder, which is returned.

    Raises as runs_here.
    """
    top, web = scratch / run_name(remote.name), remote.is_web()
    if web and not (remote / "run.json").is_file():
        raise NotARun(str(remote), "is no finished run: it has no run.json")
    if not web and not is_run(cast(Path, remote)) and (remote / SUMMARY).is_file():
        fetch({SUMMARY: remote / SUMMARY}, top)
    for run in [remote] if web else cast(list[RemotePath], find_runs([cast(Path, remote)])):
        inside = [run_name(name) for name in run.url.removeprefix(remote.url.rstrip("/")).strip("/").split("/") if name]
        # A web server cannot list files, so each that a run may have is tried.
        there = (run / name for name in sorted(names)) if web else run.iterdir()
        found = {file.name: file for file in there if file.name in names and file.is_file()}
        fetch(found, top.joinpath(*inside))
    return top


def own_files(entries: Iterable[RemotePath]) -> dict[str, RemotePath]:
    """Quadlog's files in a run folder, by relative name."""
    found: dict[str, RemotePath] = {}
    for each in entries:
        if each.name in OWN_FILES and each.is_file():
            found[each.name] = each
        elif each.name == PLOTS and each.is_dir():
            plots = {f"{PLOTS}/{plot.name}": plot for plot in each.iterdir() if plot.is_file()}
            found |= {name: plot for name, plot in plots.items() if name in OWN_PICTURES}
    return found


def fetch(files: Mapping[str, RemotePath], folder: Path) -> None:
    """Copy files, by relative name, into a folder. Raises TooLarge, StorageFailed."""
    total = sum(remote.info().st_size for remote in files.values())
    if total > MAX_BYTES:
        raise TooLarge(f"{folder.name}: bytes of a run to copy", total, MAX_BYTES)
    for name, each in files.items():
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        copy_object(each, target)


def refuse_existing(
    path: Path, force: bool, inputs: Iterable[object] = (), *, own: Collection[str] = (), recording: bool = False
) -> None:
    """Raises AlreadyExists for a file that is there, unless `force`; it replaces regular files alone.

    inputs: what the command reads, of which paths count. own: tables of a folder that this command replaces.
    recording: whether the file will be a recording, and may replace one that quadlog wrote.
    Raises CannotWrite for a link, a folder, a FIFO or a device; UsageError, whatever `force`, for an input, a recording
    and a file of a run, there or not, or of a folder of results.
    """
    if why := _never_replaced(path, inputs, own, recording):
        raise UsageError(f"{path} is {why}; choose another place by -o")
    if path.is_symlink() or (path.exists() and not path.is_file()):
        kind = "a link" if path.is_symlink() else "a folder" if path.is_dir() else "no regular file"
        raise CannotWrite(path, f"it is {kind}")
    if path.exists() and not force:
        raise AlreadyExists(path)


def _never_replaced(path: Path, inputs: Iterable[object], own: Collection[str], recording: bool) -> str:
    from quadlog.results.record import own_files

    folder = path.parent.resolve()
    if (path.name in OWN_FILES and is_run(folder)) or (folder.name == PLOTS and is_run(folder.parent)):
        return f"a file of the run {folder}"
    others = {name for name in _FOLDER_TABLES.difference(own) if (folder / name).exists()}
    if path.name in others | ({"report.html"} if others else set()):
        return f"a file of the folder of results {folder}"
    if path.resolve() in {file.resolve() for each in inputs if isinstance(each, Path) for file in own_files(each)}:
        return "an input of this command"
    if path.is_file():
        from quadlog.recordings.containers.open import is_recording  # slow to import

        with suppress(OSError):  # nobody may read it
            return "a recording" if is_recording(path, but_ours=recording) else ""
    return ""
