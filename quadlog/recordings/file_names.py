"""Which file names are recordings, and which of them are parts of one recording."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

_PLAIN_SUFFIXES = (".mcap", ".bag", ".db3")
# Longest first: `.bag.active` is a bag, not a file of the type `.active`. Recorders write .zstd, the zstd command .zst.
SUFFIXES = (*(f"{plain}{packed}" for plain in _PLAIN_SUFFIXES for packed in (".zstd", ".zst")), ".bag.active")
SUFFIXES += _PLAIN_SUFFIXES

DERIVED_NAME = "derived.mcap"
# What the run.json of a run folder says.
_RUN_MARK = b'"quadlog_version"'
MARK_BYTES = 1 << 20

_PART = re.compile(r"(?P<name>.+)_(?P<number>0|[1-9][0-9]{0,4})")


def recording_suffix(path: Path) -> str:
    """The suffix that makes a file look like a recording, or nothing; hidden files never do."""
    if path.name.startswith("."):
        return ""
    return next((suffix for suffix in SUFFIXES if path.name.lower().endswith(suffix)), "")


def stem(path: Path) -> str:
    """The file name without a recording's suffix."""
    suffix = recording_suffix(path)
    return path.name[: len(path.name) - len(suffix)] if suffix else path.name


def recording_files(folder: Path) -> list[Path]:
    """The files in a folder that look like recordings, by name."""
    return sorted(path for path in folder.iterdir() if recording_suffix(path) and path.is_file())


def part_number(path: Path) -> int | None:
    """The n of `NAME_<n>.mcap`, None where there is none."""
    match = _PART.fullmatch(stem(path))
    return int(match["number"]) if match else None


def split_sequence(files: Iterable[Path]) -> list[Path]:
    """The files in order of their numbers if all are `NAME_<n>` with one NAME, starting at 0 or 1; else nothing.

    A lone `NAME_7.mcap`, or times of day such as `run_14_05` and `run_14_55`, are recordings of their own.
    """
    files = list(files)
    parts = [_PART.fullmatch(stem(path)) for path in files]
    families = {(match["name"], recording_suffix(path)) for match, path in zip(parts, files, strict=True) if match}
    if None in parts or len(families) != 1:
        return []
    ordered = sorted(files, key=lambda path: part_number(path) or 0)
    first = part_number(ordered[0])
    return ordered if first == 0 or (first == 1 and len(ordered) > 1) else []


def is_result(path: Path) -> bool:
    """Whether a file is the `derived.mcap` of a run folder: made from a recording, and none itself."""
    return path.name == DERIVED_NAME and says_run(path.parent)


def says_run(folder: Path) -> bool:
    """Whether quadlog made this folder as a run, by the beginning of its run.json."""
    if not (folder / "run.json").is_file():
        return False
    with (folder / "run.json").open("rb") as file:
        return _RUN_MARK in file.read(MARK_BYTES)
