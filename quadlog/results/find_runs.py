"""Which run folders a path stands for."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from quadlog.errors import NotARun
from quadlog.recordings.naming import RUN_MARKS

_DEEPEST = 3  # runs/RECORDING, or runs/COURSE-CONTROLLER/seed-000


def find_runs(paths: Sequence[Path]) -> list[Path]:
    """Every path that is a run, and of every other folder the runs in it, by name; each run once.

    A folder counts as a run when it holds a run.json or a config.toml of quadlog's, finished or not: whoever reads it
    says what is wrong with it. Hidden folders and `files_beside_runs` are left out.

    Raises NotARun for a path that is neither.
    """
    found: dict[Path, Path] = {}
    beside = files_beside_runs(paths)
    for path in paths:
        if path in beside:
            continue
        if not path.is_dir():
            raise NotARun(path, "is no folder" if path.exists() else "no such folder")
        inside = [path] if is_run(path) else list(_runs_in(path, _DEEPEST))
        if not inside:
            raise NotARun(path, "is no run, and there is none in it")
        for run in inside:
            found.setdefault(run.resolve(), run)
    return list(found.values())


def files_beside_runs(paths: Sequence[Path]) -> list[Path]:
    """The plain files among the paths that lie beside a folder among them: a shell's `runs/*` names these, too."""
    folders = {path.parent for path in paths if isinstance(path, Path) and path.is_dir()}
    return [path for path in paths if isinstance(path, Path) and path.parent in folders and path.is_file()]


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
