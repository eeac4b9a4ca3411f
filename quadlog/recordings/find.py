"""From what a user types to a list of recordings."""

from __future__ import annotations

import glob
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import cast

from quadlog.errors import NotARecording, RecordingNotFound, TooLarge
from quadlog.recordings.containers.split import is_split
from quadlog.recordings.file_names import DERIVED_NAME, is_result, recording_files, recording_suffix
from quadlog.storage.remote_path import RemotePath, to_path
from quadlog.storage.urls import is_url

MAX_LIST_BYTES = 1 << 24


def find_recordings(arguments: Sequence[str | Path]) -> list[Path]:
    """One path for each recording, sorted, none twice.

    An argument is a file, a ROS 2 bag folder, a folder that is searched with
    all folders below it, also linked ones, a glob pattern, or `@list.txt` with
    one of these on each line (`#` starts a comment; paths as seen from the
    working folder, else from the list's). Hidden files and the
    `derived.mcap` of run folders are skipped unless named. Each may be a URL;
    a list behind one names URLs, and what lies beside it or below.

    Raises RecordingNotFound for an argument that leads to no recording or a
    folder that cannot be read, NotARecording for a pipe or a device;
    FileError and StorageFailed.
    """
    found: dict[Path, Path] = {}
    for argument in arguments:
        try:
            text = str(argument)
            is_list = text.startswith("@") and (is_url(text) or not Path(text).exists())
            for path in _read_list(to_path(text[1:])) if is_list else _match(to_path(argument)):
                for recording in _recordings_at(path):
                    found.setdefault(recording.resolve(), recording)
        except OSError as error:
            where = error.filename or to_path(argument)
            raise RecordingNotFound(where, error.strerror or "no such file or folder") from None
    return sorted(found.values())


def _match(path: Path) -> list[Path]:
    """A path that is there, or what a pattern matches: it may match much that is no recording beside one."""
    if isinstance(path, RemotePath):
        if not path.has_pattern() or path.exists():
            return [cast(Path, path)]
        matches = [cast(Path, match) for match in path.matches()]
    elif path.exists() or not glob.has_magic(str(path)):
        return [path]
    else:
        matches = [Path(match) for match in sorted(glob.glob(str(path), recursive=True))]  # noqa: PTH207 - also absolute
    chosen = [match for match in matches if _is_worth_opening(match)]
    if not chosen:
        raise RecordingNotFound(path, "no recording matches the pattern")
    return chosen


def _is_worth_opening(path: Path) -> bool:
    if path.is_dir():
        return next(_search(path), None) is not None
    return bool(recording_suffix(path)) and path.is_file() and not is_result(path)


def _read_list(path: Path) -> list[Path]:
    if not path.is_file():
        raise RecordingNotFound(path, "no such list of recordings")
    if not isinstance(path, RemotePath) and path.stat().st_size > MAX_LIST_BYTES:
        raise TooLarge(f"{path}: list of recordings in bytes", path.stat().st_size, MAX_LIST_BYTES)
    try:
        # Editors of Windows put a byte order mark before the first line.
        lines = path.read_text("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise RecordingNotFound(path, "a list of recordings is a text file, this is not UTF-8") from None
    entries = [re.split(r"(?:^|\s)#", line)[0].strip() for line in lines]
    found = [match for entry in entries if entry for match in _match(_listed(entry, path))]
    if not found:
        raise RecordingNotFound(path, "the list names no recording")
    return found


def _listed(entry: str, path: Path) -> Path:
    """What a line of a list names. Whoever wrote one on a server has no say about files of this machine."""
    named = to_path(entry)
    if is_url(entry) and (isinstance(named, RemotePath) or not isinstance(path, RemotePath)):
        return named
    if isinstance(path, RemotePath):
        if is_url(entry) or entry.startswith("/") or ".." in entry.split("/"):
            raise RecordingNotFound(path, f"a list on a server names URLs or what lies beside it, not {entry}")
        return cast(Path, path.parent / entry)
    from_here = Path(entry).exists() or bool(glob.glob(entry))  # noqa: PTH207
    return Path(entry) if from_here else path.parent / entry


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
