"""Names of run folders, and of quadlog's files in them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from quadlog.recordings.file_names import stem
from quadlog.results.saved.stages import STAGE_FILES
from quadlog.results.saved.tables import TABLES
from quadlog.storage.atomic_write import is_part

FAILED = "failed.json"
"""The reason why a recording was not replayed. A folder without other files counts as absent."""
# Files that quadlog writes into a run folder; `--force` removes only these.
OWN_FILES = frozenset(
    {
        *(f"{name}.parquet" for name in TABLES if name != "summary"),
        *(file for files in STAGE_FILES.values() for file in files),
        *("run.json", "config.toml", "stages.json", "report.html", "derived.mcap", "foxglove-layout.json"),
        FAILED,
    }
)

_TAKEN = {"summary.parquet", "report.html"}  # files in a folder of runs
_MAX_BYTES = 120  # file systems allow 255 bytes; temporary files need longer names


def is_absent(name: str) -> bool:
    """Whether a folder with files of such names alone counts as absent: a failure, and what was not finished."""
    return name == FAILED or is_part(name)


def run_name(name: str) -> str:
    """`name` as the name of one folder: no separator, no control character, no leading dot or dash, not too long."""
    safe = re.sub(r"[/\\:\x00-\x1f\x7f]", "_", name).lstrip(".-").strip()
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
    often = Counter(name.casefold() for name in short)
    names = [
        name if often[name.casefold()] == 1 else run_name(path.name)
        for name, path in zip(short, recordings, strict=True)
    ]
    taken: set[str] = set()
    for i, name in enumerate(names):
        number = 2
        while names[i].casefold() in taken:
            names[i] = f"{name}-{number}"
            number += 1
        taken.add(names[i].casefold())
    return names
