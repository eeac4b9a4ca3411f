"""Names of run folders that stay what they are when recordings are added to a season, or taken away."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from quadlog.errors import NotARun, UnknownRunFormat
from quadlog.recordings.naming import stem
from quadlog.results.names import run_name, run_names
from quadlog.results.run_folder import read_run_json


def kept_names(recordings: Sequence[Path], output: Path) -> list[str]:
    """A folder name for each recording: that of the run it has in the output folder, else what `run_names` gives.

    Only where several names come into question are runs asked which recording they are of.
    """
    fresh = run_names(recordings)
    there = [entry.name for entry in output.iterdir()] if output.is_dir() else []
    kept = _kept(recordings, fresh, output, there)
    taken = {name.casefold() for name in kept.values()}
    names = []
    for number, name in enumerate(fresh):
        chosen = kept.get(number) or _free(name, taken)
        taken.add(chosen.casefold())
        names.append(chosen)
    return names


def _kept(recordings: Sequence[Path], fresh: Sequence[str], output: Path, there: Iterable[str]) -> dict[int, str]:
    """By the recordings' places, the names of the runs they have under any name that could be theirs."""
    families: dict[str, list[str]] = {}
    for name in there:
        families.setdefault(_family(name), []).append(name)
    alike = Counter(_family(name) for name in fresh)
    kept: dict[int, str] = {}
    given: set[str] = set()
    runs: dict[str, Mapping[str, str]] = {}
    for number, (recording, name) in enumerate(zip(recordings, fresh, strict=True)):
        family = _family(name)
        names = families.get(family, [])
        if not names or (alike[family] == 1 and names == [name]):
            continue
        if family not in runs:
            runs[family] = {_place(path): each for each in sorted(names) if (path := _recording_of(output / each))}
        mine = runs[family].get(_place(recording))
        if mine is not None and mine not in given:
            kept[number] = mine
            given.add(mine)
    return kept


def _family(name: str) -> str:
    """What names that could be one recording's have in common: `walk`, `walk.bag` and `walk.bag-2` are of one."""
    plain = re.sub(r"-[0-9]{1,6}$", "", name)
    return run_name(stem(Path(plain if stem(Path(plain)) != plain else name))).casefold()


def _free(name: str, taken: set[str]) -> str:
    free, number = name, 2
    while free.casefold() in taken:
        free = f"{name}-{number}"
        number += 1
    return free


def _recording_of(run: Path) -> str | None:
    try:
        told = read_run_json(run)["input"]["path"]
    except (NotARun, UnknownRunFormat, LookupError, TypeError):
        return None
    return told if isinstance(told, str) else None


def _place(recording: Path | str) -> str:
    """The recording as a whole path; a URL is one."""
    text = str(recording)
    return text if "://" in text else str(Path(text).absolute())
