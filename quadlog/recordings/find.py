"""From what a user types to a list of recordings."""

from __future__ import annotations

import glob
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from quadlog.errors import NotARecording, RecordingNotFound, TooLarge
from quadlog.recordings.naming import DERIVED_NAME, is_result, recording_files, recording_suffix
from quadlog.recordings.split import is_split

MAX_LIST_BYTES = 1 << 24


def find_recordings(arguments: Sequence[str | Path]) -> list[Path]:
    """One path for each recording, sorted, none twice.

    An argument is a file, a ROS 2 bag folder, a folder that is searched with
    all folders below it, also linked ones, a glob pattern, or `@list.txt` with
    one of these on each line (`#` starts a comment; paths as seen from the
    working folder, else from the list's). Hidden files and the
    `derived.mcap` of run folders are skipped unless named.

    Raises RecordingNotFound for an argument that leads to no recording or a
    folder that cannot be read, NotARecording for a pipe or a device.
    """
    found: dict[Path, Path] = {}
    for argument in map(str, arguments):
        try:
            for path in _expand(argument):
                for recording in _recordings_at(path):
                    found.setdefault(recording.resolve(), recording)
        except OSError as error:
            raise RecordingNotFound(error.filename or argument, error.strerror or str(error)) from None
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
    chosen = [path for path in matches if _is_worth_opening(path)]
    if not chosen:
        raise RecordingNotFound(argument, "no recording matches the pattern")
    return chosen


def _is_worth_opening(path: Path) -> bool:
    if path.is_dir():
        return next(_search(path), None) is not None
    return bool(recording_suffix(path)) and path.is_file() and not is_result(path)


def _read_list(path: Path) -> list[Path]:
    if not path.is_file():
        raise RecordingNotFound(path, "no such list of recordings")
    if path.stat().st_size > MAX_LIST_BYTES:
        raise TooLarge(f"{path}: list of recordings in bytes", path.stat().st_size, MAX_LIST_BYTES)
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
        if not path.is_file():
            raise NotARecording(path, "not a regular file")
        return [path]
    found = list(_search(path))
    if not found:
        own = is_result(path / DERIVED_NAME)
        raise RecordingNotFound(path, "a run folder of quadlog, no recording" if own else "no recording in this folder")
    return found


def _search(top: Path) -> Iterator[Path]:
    """Recordings in a folder and below, each folder once however many links lead to it."""
    seen: set[Path] = set()
    folders = [top]
    while folders:
        folder = folders.pop()
        real = folder.resolve()
        if real in seen:
            continue
        seen.add(real)
        folders += sorted(each for each in folder.iterdir() if each.is_dir() and not each.name.startswith("."))
        if is_split(folder):
            yield folder
        else:
            yield from (path for path in recording_files(folder) if not is_result(path))
