"""Run folders behind URLs, copied to this machine to be read: their own files and nothing else that lies there."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import cast

from quadlog.errors import NotARun, TooLarge
from quadlog.results.find_runs import find_runs, is_run
from quadlog.results.names import OWN_FILES, run_name
from quadlog.storage.copying import copy_object
from quadlog.storage.remote_path import RemotePath

PLOTS = "plots"
_SUMMARY = "summary.parquet"
# What tells of a run in a few kilobytes.
RECORDS = frozenset({"run.json", "config.toml", "metrics.json"})
# What metrics are made of: tables, and what tells of the run.
MEASURED = frozenset(name for name in OWN_FILES if name.endswith((".parquet", ".json", ".toml")))
# Far above what runs hold, below what a machine has to spare.
MAX_BYTES = 1 << 36


class RunsHere(list[Path]):
    """Paths of this machine, each in the place of what was given."""

    def __init__(self, paths: Iterable[Path], given: Sequence[Path]) -> None:
        super().__init__(paths)
        self._given = list(given)

    def as_given(self, path: Path | str) -> str:
        """A path here, or of a run in it, as whoever gave it knows it."""
        for here, given in zip(self, self._given, strict=True):
            if isinstance(given, RemotePath) and Path(path).is_relative_to(here):
                return "/".join([str(given).rstrip("/"), *Path(path).relative_to(here).parts])
        return str(path)


@contextmanager
def runs_here(paths: Sequence[Path], names: Collection[str] = OWN_FILES) -> Iterator[RunsHere]:
    """The paths, and for each URL among them a copy of the run there, or of all runs in that folder, with these files.

    The copies vanish when the block ends. Raises NotARun, TooLarge, StorageFailed.
    """
    if not any(isinstance(path, RemotePath) for path in paths):
        yield RunsHere(paths, paths)
        return
    with tempfile.TemporaryDirectory(prefix="quadlog-") as scratch:
        here = [
            fetch_runs(path, Path(scratch) / str(number), names) if isinstance(path, RemotePath) else path
            for number, path in enumerate(paths)
        ]
        yield RunsHere(here, paths)


def fetch_runs(remote: RemotePath, scratch: Path, names: Collection[str] = OWN_FILES) -> Path:
    """A run, or a folder of runs with its summary, copied to a new folder; returns where it is. Raises as runs_here."""
    top = scratch / run_name(remote.name)
    if not remote.is_web() and not is_run(cast(Path, remote)) and (remote / _SUMMARY).is_file():
        fetch({_SUMMARY: remote / _SUMMARY}, top)
    for run in _runs_at(remote):
        inside = [run_name(name) for name in run.url.removeprefix(remote.url.rstrip("/")).strip("/").split("/") if name]
        fetch({name: file for name, file in _files_at(run).items() if name in names}, top.joinpath(*inside))
    return top


def own_files(entries: Iterable[RemotePath]) -> dict[str, RemotePath]:
    """Files of quadlog's own among what a run's folder holds, by their names as seen from it."""
    found: dict[str, RemotePath] = {}
    for each in entries:
        if each.name in OWN_FILES and each.is_file():
            found[each.name] = each
        elif each.name == PLOTS and each.is_dir():
            found |= {f"{PLOTS}/{plot.name}": plot for plot in each.iterdir() if _is_plot(plot)}
    return found


def fetch(files: Mapping[str, RemotePath], folder: Path) -> None:
    """Copy files, by their names as seen from it, into a new folder. Raises TooLarge, StorageFailed."""
    objects = {name: remote.open_object() for name, remote in files.items()}
    total = sum(each.told.size_bytes or 0 for each in objects.values())
    if total > MAX_BYTES:
        raise TooLarge(f"{folder.name}: bytes of a run to copy", total, MAX_BYTES)
    for name, each in objects.items():
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        copy_object(each, target)


def _runs_at(remote: RemotePath) -> list[RemotePath]:
    if remote.is_web():
        if not (remote / "run.json").is_file():
            raise NotARun(str(remote), "is no finished run: it has no run.json")
        return [remote]
    return [cast(RemotePath, run) for run in find_runs([cast(Path, remote)])]


def _files_at(run: RemotePath) -> dict[str, RemotePath]:
    """A web server lists nothing, so it is asked for each file that a run may have."""
    if run.is_web():
        return {name: run / name for name in sorted(OWN_FILES) if (run / name).is_file()}
    return own_files(run.iterdir())


def _is_plot(path: RemotePath) -> bool:
    return path.suffix == ".png" and path.name == run_name(path.name) and path.is_file()
