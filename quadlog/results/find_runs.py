"""Which run folders a path stands for."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from quadlog.errors import NotARun
from quadlog.recordings.naming import RUN_MARKS

_BESIDE_RUNS = frozenset({"summary.parquet", "report.html"})  # what `runs/*` names too
_DEEPEST = 3  # runs/RECORDING, or runs/COURSE-CONTROLLER/seed-000


def find_runs(paths: Iterable[Path]) -> list[Path]:
    """Every path that is a run, and of every other folder the runs in it, by name; each run once.

    A folder counts as a run when it holds a run.json or a config.toml of quadlog's, finished or not: whoever reads it
    says what is wrong with it. Hidden folders are left out.

    Raises NotARun for a path that is neither.
    """
    found: dict[Path, Path] = {}
    for path in paths:
        if found and path.name in _BESIDE_RUNS and path.is_file():
            continue
        if not path.is_dir():
            raise NotARun(path, "is no folder" if path.exists() else "no such folder")
        inside = [path] if is_run(path) else list(_runs_in(path, _DEEPEST))
        if not inside:
            raise NotARun(path, "is no run, and there is none in it")
        for run in inside:
            found.setdefault(run.resolve(), run)
    return list(found.values())


def is_run(folder: Path) -> bool:
    """Whether quadlog made this folder as a run."""
    if (folder / "run.json").is_file():
        return True
    mark = RUN_MARKS["config.toml"]
    try:
        with (folder / "config.toml").open("rb") as file:
            return file.read(len(mark)) == mark
    except OSError:
        return False


def run_labels(runs: Iterable[Path]) -> list[str]:
    """The shortest names that tell the runs apart: their paths without the folders that all have in common."""
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
