"""What a process does that helps with a long recording: it opens it once, and answers window after window."""

from __future__ import annotations

import itertools
import os
from dataclasses import dataclass
from pathlib import Path

from quadlog.pipelines.stages.parcel import Parcel, pack
from quadlog.pipelines.stages.windows import Scan, Seen, Source, Window, WindowReader


@dataclass(frozen=True, slots=True)
class Answer:
    """What a window holds: its scans, those of another process in a parcel; None where they are too many to hold."""

    scans: list[Scan] | Parcel | None
    seen: Seen


def answer(reader: WindowReader, window: Window, most_scans: int) -> Answer:
    """All scans of a window, classified. Raises as reading does."""
    scans: list[Scan] = []
    for scan in reader.read(window):
        if len(scans) == most_scans:
            return Answer(None, reader.seen())
        scans.append(scan)
    return Answer(scans, reader.seen())


@dataclass(frozen=True, slots=True)
class _Helper:
    reader: WindowReader
    folder: Path
    most_scans: int


_helper: _Helper | None = None
_numbers = itertools.count()


def begin_helper(source: Source, folder: Path, most_scans: int) -> None:
    """The first that a process is told; folder: where its parcels go."""
    global _helper
    _helper = _Helper(WindowReader(source, source.open()), folder, most_scans)
    _helper.reader.rehearse()


def is_ready() -> bool:
    """Whether the process has begun."""
    return _helper is not None


def help_with(window: Window) -> Answer:
    """The answer of this process. Raises as reading does, and OSError when there is no room for the parcel."""
    assert _helper is not None
    answered = answer(_helper.reader, window, _helper.most_scans)
    if answered.scans is None:
        return answered
    parcel = pack(answered.scans, _helper.folder / f"{os.getpid()}-{next(_numbers)}")
    return Answer(parcel, answered.seen)
