"""`stages.json`: the finished stages with their files, so that a replay can continue after them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from quadlog.errors import CannotWrite
from quadlog.results.find_runs import OWN_FILES
from quadlog.storage.atomic_write import write_whole
from quadlog.storage.remote_path import RemotePath

MARKS_FILE = "stages.json"
_MAX_BYTES = 16 << 20


class Marked(BaseModel):
    """Strict validation: no other fields, no type conversion."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")


class FileMark(Marked):
    """A file as its stage wrote it."""

    name: str
    size_bytes: int = Field(ge=0)
    sha256: str


class StageMark(Marked):
    """A finished stage.

    stage: its name, or the last one of stages that share a pass. key: digest of all that its results depend on.
    files: those it wrote. known: what later stages need beside the files.
    """

    stage: str
    key: str
    files: list[FileMark]
    known: dict[str, Any]


class _Marks(Marked):
    marks_format: Literal[1] = 1
    stages: list[StageMark]


def read_marks(run: Path) -> dict[str, StageMark]:
    """The marks of a run folder by stage, not yet compared with its files; none if the file is missing or damaged."""
    path = run / MARKS_FILE
    try:
        if path.stat().st_size > _MAX_BYTES:
            return {}
        marks = _Marks.model_validate(json.loads(path.read_bytes()))
    except (OSError, ValueError, RecursionError):
        return {}
    return {mark.stage: mark for mark in marks.stages}


def write_marks(run: Path, marks: Sequence[StageMark]) -> None:
    """Replace the marks of a run folder. Raises CannotWrite."""
    # Not pydantic's JSON: names of files and topics may contain lone surrogates.
    write_whole(run / MARKS_FILE, (json.dumps(_Marks(stages=list(marks)).model_dump(), indent=1) + "\n").encode())


def mark_files(run: Path, names: Iterable[str]) -> list[FileMark]:
    """The named files of a run folder as they are now. Raises CannotWrite for a missing one."""
    return [_mark(run / name) for name in names]


def files_are_whole(run: Path, mark: StageMark) -> bool:
    """Whether all files of a mark exist, are quadlog's and not links, and have the same content.

    Of remote files only the size is compared: object storage never has partial files.
    """
    there = {entry.name: entry for entry in run.iterdir() if entry.name in OWN_FILES}
    return all(each.name in there and _is_whole(there[each.name], each) for each in mark.files)


def _mark(path: Path) -> FileMark:
    try:
        return FileMark(name=path.name, size_bytes=path.stat().st_size, sha256=_digest(path))
    except FileNotFoundError as error:
        raise CannotWrite(path, "another process has removed it") from error


def _is_whole(path: Path, mark: FileMark) -> bool:
    try:
        if path.is_symlink() or not path.is_file() or path.stat().st_size != mark.size_bytes:
            return False
        return isinstance(path, RemotePath) or _digest(path) == mark.sha256
    except OSError:
        return False


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
