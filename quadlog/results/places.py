"""Where a run is made: beside its place, which it takes when it is complete; the run before stands until then."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from quadlog.errors import CannotWrite, RunExists
from quadlog.recordings.file_names import says_run
from quadlog.results.find_runs import OWN_FILES, is_absent
from quadlog.storage.atomic_write import check_name, is_part, move_folder, new_folder, part_folder, uninterrupted

STORE = ".stages"
"""The folder beside runs that holds results of stages, and what is not complete; no command takes it for a run."""
_NEW, _OLD = "new-", "old-"


@contextmanager
def new_run(path: Path, force: bool = False) -> Iterator[Path]:
    """A folder below `.stages` to fill, which becomes the run `path` when the block ends, and vanishes if it fails.

    A run that is replaced, with `force`, stands until then; files in it that are not quadlog's stay. Raises as
    `check_place`, and CannotWrite.
    """
    check_place(path, force)
    try:
        with new_folder(path.parent), part_folder(path.parent / STORE) as part:
            yield part
            try:
                with uninterrupted():
                    new = path.parent / STORE / f"{_NEW}{path.name}"
                    shutil.rmtree(new, ignore_errors=True)
                    move_folder(part, new)
                    settle(path)
            except OSError as error:
                raise CannotWrite(path, error.strerror or str(error)) from error
    finally:
        with suppress(OSError):
            (path.parent / STORE).rmdir()  # where it holds no results


def check_place(path: Path, replace: bool = False) -> None:
    """Whether a run may be made here.

    Raises RunExists for a run without the flag; CannotWrite if the folder is no run but has files, or is a link.
    """
    check_name(path)
    settle(path)
    try:
        names = {entry.name for entry in path.iterdir()} if path.exists() or path.is_symlink() else set()
    except OSError as error:
        raise CannotWrite(path, error.strerror or str(error)) from error
    if path.is_symlink() and replace:
        raise CannotWrite(path, "it is a symbolic link, and --force removes nothing behind one")
    if all(is_absent(name) for name in names):
        return
    if not says_run(path):
        raise CannotWrite(path, "the folder holds other files and is no run of quadlog")
    if not replace:
        raise RunExists(path)


def settle(path: Path) -> None:
    """Put a complete new run in its place by two renames, unless a kill cut these off: then what is left of them.

    Raises CannotWrite.
    """
    new, old = (path.parent / STORE / f"{prefix}{path.name}" for prefix in (_NEW, _OLD))
    try:
        if new.is_dir():
            if path.is_dir() and not old.exists():
                move_folder(path, old)
            move_folder(new, path)
        if old.is_dir() and path.is_dir():
            for entry in [*old.glob("plots/*"), *old.iterdir()]:
                name = entry.relative_to(old)
                if not _is_own(name) and not (path / name).exists():
                    (path / name).parent.mkdir(exist_ok=True)
                    entry.rename(path / name)
            shutil.rmtree(old, ignore_errors=True)
        elif old.is_dir():
            move_folder(old, path)
    except OSError as error:
        raise CannotWrite(path, error.strerror or str(error)) from error


def _is_own(name: Path) -> bool:
    """Whether a file of a run is quadlog's."""
    picture = name.parent.name == "plots" and name.suffix == ".png"
    return picture or is_part(name.name) or str(name) in OWN_FILES | {"plots"}
