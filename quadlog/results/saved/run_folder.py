"""The folder of a run: created without overwriting anything, filled file by file, finished by `run.json`."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import tomli_w

from quadlog.errors import CannotWrite, NotARun, RunExists, UnknownRunFormat, clipped, printable
from quadlog.results.record import RunRecord, read_object, read_record
from quadlog.results.saved.names import OWN_FILES, is_absent
from quadlog.storage.atomic_write import check_name, is_part, move_whole, remove_stale_parts, uninterrupted, write_whole

_CONFIG_HEADER = "# quadlog: the effective config; replay with -c on this file gives the same run\n"


@dataclass(frozen=True, slots=True)
class RunFolder:
    """A folder that is or becomes a run; stages write their files to `path / name`."""

    path: Path

    @classmethod
    def create(cls, path: Path, force: bool = False) -> Self:
        """Make the folder `path`, or take over an existing run.

        An existing run needs `force`; quadlog's files in it are removed, all others are kept. Raises as `claim` does.
        """
        folder = cls.claim(path, replace=force)
        if force:
            _remove_own_files(path, OWN_FILES)
        return folder

    @classmethod
    @contextmanager
    def create_whole(cls, path: Path, force: bool = False) -> Iterator[Self]:
        """`create` for a run that cannot be resumed: its files are removed if the block fails.

        A finished run stands until the new one, in `place_of_new(path)` meanwhile, is complete.
        """
        place = path
        if force and (path / "run.json").is_file():
            cls.claim(path, replace=True)
            place = place_of_new(path)
        folder = cls.create(place, force)
        try:
            yield folder
        except BaseException:
            with suppress(CannotWrite):
                _remove_own_files(place, OWN_FILES)
            with suppress(OSError):  # it has other files
                place.rmdir()
                place.parent.rmdir()
            raise
        publish_new(path)

    @classmethod
    def claim(cls, path: Path, replace: bool = False) -> Self:
        """Make the folder `path`, or with `replace` take over an existing run, whose results are kept until `begin`.

        Raises RunExists without the flag; CannotWrite if the folder is not a run but has files, is a symbolic link, or
        cannot be made.
        """
        check_name(path)
        try:
            path.mkdir(parents=True, exist_ok=True)
            names = {entry.name for entry in path.iterdir()}
        except OSError as error:
            raise CannotWrite(path, error.strerror or str(error)) from error
        if all(is_absent(name) for name in names):
            remove_stale_parts(path)
            return cls(path)
        if not _is_ours(path):
            raise CannotWrite(path, "the folder holds other files and is no run of quadlog")
        if not replace:
            raise RunExists(path)
        if replace and path.is_symlink():
            raise CannotWrite(path, "it is a symbolic link, and --force removes nothing behind one")
        remove_stale_parts(path)
        return cls(path)

    def begin(self, config: Mapping[str, Any], keep: Collection[str]) -> None:
        """Write `config.toml` and remove quadlog's own files but those to keep.

        `run.json` is removed first, so that the run is unfinished after a kill; `config.toml` then still marks the
        folder as quadlog's. Links are removed, never followed. Raises CannotWrite.
        """
        _remove_own_files(self.path, ())
        self.write_config(config)
        _remove_own_files(self.path, OWN_FILES - {"config.toml", *keep})

    def discard_if_empty(self) -> None:
        """Remove the folder if the run failed before its first result, so that the next try needs no flag."""
        with suppress(OSError):  # another process writes to it or has removed it
            names = {entry.name for entry in self.path.iterdir()}
            if names <= {"config.toml"} and not self.path.is_symlink():
                (self.path / "config.toml").unlink(missing_ok=True)
                self.path.rmdir()

    def write_config(self, config: Mapping[str, Any]) -> None:
        """`config.toml`, the first file: it marks the folder as quadlog's. Keys without a value are left out."""
        write_whole(self.path / "config.toml", (_CONFIG_HEADER + tomli_w.dumps(_without_none(config))).encode())

    def write_metrics(self, metrics: Mapping[str, Mapping[str, Any]]) -> None:
        """`metrics.json`: name: {value, n, unit}, and low and high where both are there and finite.

        A metric without a finite value does not apply and is left out.
        """
        kept = {
            name: {"value": _plain(metric["value"]), "n": int(metric["n"]), "unit": str(metric["unit"])}
            | _ends(metric)
            | {key: _plain(metric[key]) for key in ("worst", "worst_t_ns") if key in metric}
            for name, metric in metrics.items()
            if metric["value"] is not None and math.isfinite(metric["value"])
        }
        write_whole(self.path / "metrics.json", to_json(kept))

    def write_run_json(self, record: RunRecord) -> None:
        """`run.json`, the last file: it marks the run as finished."""
        write_whole(self.path / "run.json", to_json(record.to_dict()))


def place_of_new(run: Path) -> Path:
    """Where a run is made that replaces `run` when it is complete; no command takes it for a run."""
    return run.parent / ".stages" / run.name


def publish_new(run: Path) -> None:
    """Replace the run by the complete one in `place_of_new`, if there is one; files that are not quadlog's stay.

    To be repeated after a kill: `config.toml` goes first, after the earlier run is removed, and `run.json` last. Raises
    CannotWrite.
    """
    new = place_of_new(run)
    if not (new / "run.json").is_file():
        return
    ends = {"config.toml": -1, "run.json": 1}
    try:
        with uninterrupted():
            run.mkdir(exist_ok=True)
            if (new / "config.toml").is_file():
                _remove_own_files(run, OWN_FILES)
            files = [path.relative_to(new) for path in new.rglob("*") if path.is_file() and not is_part(path.name)]
            for name in sorted(files, key=lambda name: (ends.get(str(name), 0), name)):
                (run / name).parent.mkdir(exist_ok=True)
                move_whole(new / name, run / name)
            remove_new(run)
    except OSError as error:
        raise CannotWrite(run, error.strerror or str(error)) from error


def remove_new(run: Path) -> None:
    """Remove what is in `place_of_new`, and the folder around it if it is empty."""
    shutil.rmtree(place_of_new(run), ignore_errors=True)
    with suppress(OSError):  # there are others
        place_of_new(run).parent.rmdir()


def read_metrics(run: Path) -> dict[str, dict[str, Any]]:
    """`metrics.json` of a run: name: {value, n, unit, ...}. Raises NotARun where it is missing or damaged."""
    metrics = read_object(run, "metrics.json", "has no metrics.json")
    for name, metric in metrics.items():
        if not isinstance(metric, dict) or not _is_sound(metric):
            raise NotARun(run / "metrics.json", f"is damaged: {clipped(printable(name), 60)} has no value")
    return metrics


def to_json(content: Any) -> bytes:
    """Indented JSON with sorted keys, without NaN, with a trailing newline."""
    return (json.dumps(content, indent=2, sort_keys=True, allow_nan=False, default=_plain) + "\n").encode()


def _ends(metric: Mapping[str, Any]) -> dict[str, float]:
    ends = {name: float(metric[name]) for name in ("low", "high") if name in metric}
    return ends if len(ends) == 2 and all(map(math.isfinite, ends.values())) else {}


def _is_sound(metric: Mapping[str, Any]) -> bool:
    """Whether the metric has a value, and valid n, unit and instant, if present."""
    numbers = [metric.get("value"), *(metric[name] for name in ("low", "high", "worst") if name in metric)]
    integers = [metric.get(name, 0) for name in ("n", "worst_t_ns")]
    if any(type(each) not in (int, float) for each in numbers) or any(type(each) is not int for each in integers):
        return False
    return isinstance(metric.get("unit", ""), str) and integers[0] >= 0


def _is_ours(path: Path) -> bool:
    """Whether quadlog made this folder, by the content of its files; other programs have a config.toml, too."""
    config = path / "config.toml"
    try:
        if config.is_file():
            with config.open("rb") as file:
                if file.read(len(_CONFIG_HEADER)) == _CONFIG_HEADER.encode():
                    return True
        read_record(path)
    except UnknownRunFormat:
        return True
    except (NotARun, OSError):
        return False
    return True


def _remove_own_files(path: Path, names: Collection[str]) -> None:
    """Remove `run.json`, then pictures, then these files."""
    plots = path / "plots"
    pictures: list[Path] = []
    if plots.is_dir() and not plots.is_symlink():
        remove_stale_parts(plots)
        pictures = sorted(plots.glob("*.png"))
    try:
        for own in [path / "run.json", *pictures, *(path / name for name in sorted(names))]:
            if own.is_symlink() or own.is_file():
                own.unlink(missing_ok=True)
        if plots.is_symlink():
            plots.unlink(missing_ok=True)
        elif plots.is_dir() and not any(plots.iterdir()):
            with suppress(OSError):  # another process is drawing
                plots.rmdir()
    except OSError as error:
        raise CannotWrite(path, error.strerror or str(error)) from error


def _without_none(value: Any) -> Any:
    """TOML has no null: a key without a value is left out, which means the default."""
    if isinstance(value, Mapping):
        return {key: _without_none(each) for key, each in value.items() if each is not None}
    return [_without_none(each) for each in value] if isinstance(value, list | tuple) else value


def _plain(value: Any) -> Any:
    """Numpy scalars as Python numbers, paths as text."""
    if isinstance(value, Path):
        return str(value)
    return value.item() if hasattr(value, "item") else value
