"""From what a user types to a list of recordings."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Sequence
from pathlib import Path

from quadlog.errors import RecordingNotFound
from quadlog.recordings.naming import recording_files, recording_suffix
from quadlog.recordings.split import is_split


def find_recordings(arguments: Sequence[str | Path]) -> list[Path]:
    """One path for each recording, sorted, none twice.

    An argument is a file, a ROS 2 bag folder, a folder that is searched with
    all folders below it, a glob pattern, or `@list.txt` with one of these on
    each line (`#` starts a comment; paths as seen from the working folder, else
    from the list's). Hidden files are skipped unless named.

    Raises RecordingNotFound for an argument that leads to no recording.
    """
    found: dict[Path, Path] = {}
    for argument in map(str, arguments):
        try:
            for path in _expand(argument):
                for recording in _recordings_at(path):
                    found.setdefault(recording.resolve(), recording)
        except OSError as error:
            raise RecordingNotFound(argument, error.strerror or str(error)) from None
    return sorted(found.values())


def _expand(argument: str) -> list[Path]:
    if argument.startswith("@") and not Path(argument).exists():
        return _read_list(Path(argument[1:]))
    return _match(argument)


def _match(argument: str) -> list[Path]:
    if Path(argument).exists() or not glob.has_magic(argument):
        return [Path(argument)]
    # A pattern may match much that is no recording; that is an error only when nothing else is left.
    matches = [Path(match) for match in sorted(glob.glob(argument, recursive=True))]  # noqa: PTH207 - also absolute ones
    chosen = [path for path in matches if (_search(path) if path.is_dir() else recording_suffix(path))]
    if not chosen:
        raise RecordingNotFound(argument, "no recording matches the pattern")
    return chosen


def _read_list(path: Path) -> list[Path]:
    if not path.is_file():
        raise RecordingNotFound(path, "no such list of recordings")
    try:
        lines = path.read_text("utf-8").splitlines()
    except UnicodeDecodeError:
        raise RecordingNotFound(path, "a list of recordings is a text file, this is not UTF-8") from None
    found: list[Path] = []
    for line in lines:
        entry = re.split(r"(?:^|\s)#", line)[0].strip()
        if entry:
            from_here = Path(entry).exists() or bool(glob.glob(entry))  # noqa: PTH207
            found += _match(entry if from_here else str(path.parent / entry))
    if not found:
        raise RecordingNotFound(path, "the list names no recording")
    return found


def _recordings_at(path: Path) -> list[Path]:
    if not path.exists():
        raise RecordingNotFound(path)
    if not path.is_dir():
        return [path]
    found = _search(path)
    if not found:
        raise RecordingNotFound(path, "no recording in this folder")
    return found


def _search(folder: Path) -> list[Path]:
    found: list[Path] = []
    for name, folders, _ in os.walk(folder):
        here = Path(name)
        folders[:] = sorted(each for each in folders if not each.startswith("."))
        if is_split(here):
            found.append(here)
        else:
            found += recording_files(here)
    return found
