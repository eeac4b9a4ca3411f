"""Where a run is made: its folder is claimed without overwriting anything; a run stands until its successor does."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from quadlog.errors import CannotWrite, RunExists
from quadlog.recordings.file_names import says_run
from quadlog.results.find_runs import OWN_FILES, is_absent
from quadlog.results.record import is_finished, read_record, write_record
from quadlog.storage.atomic_write import check_name, is_part, move_whole, remove_stale_parts, uninterrupted

_FIRST = {"run.json", "config.toml"}


def claim(path: Path, replace: bool = False) -> None:
    """Make the folder `path`, or with `replace` take over an existing run, whose files are kept until Run.create.

    Raises RunExists without the flag; CannotWrite if the folder is not a run but has files, is a symbolic link, or
    cannot be made.
    """
    check_name(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        names = {entry.name for entry in path.iterdir()}
    except OSError as error:
        raise CannotWrite(path, error.strerror or str(error)) from error
    if not all(is_absent(name) for name in names):
        if not says_run(path):
            raise CannotWrite(path, "the folder holds other files and is no run of quadlog")
        if not replace:
            raise RunExists(path)
        if path.is_symlink():
            raise CannotWrite(path, "it is a symbolic link, and --force removes nothing behind one")
    remove_stale_parts(path)


def discard_if_empty(path: Path) -> None:
    """Remove the folder of a run that failed before its first result, so that the next try needs no flag."""
    with suppress(OSError):  # another process writes to it or has removed it
        if {entry.name for entry in path.iterdir()} <= _FIRST and not path.is_symlink() and not is_finished(path):
            for name in _FIRST:
                (path / name).unlink(missing_ok=True)
            path.rmdir()


@contextmanager
def whole_run(path: Path, force: bool = False) -> Iterator[Path]:
    """The folder to make a run in that cannot be resumed: quadlog's files in it are removed if the block fails.

    A finished run stands until the new one, in `place_of_new(path)` meanwhile, is complete. Raises as `claim` does.
    """
    place = path
    if force and is_finished(path):
        claim(path, replace=True)
        place = place_of_new(path)
    claim(place, replace=force)
    try:
        yield place
    except BaseException:
        with suppress(CannotWrite):
            remove_own_files(place)
        with suppress(OSError):  # it has other files
            place.rmdir()
            place.parent.rmdir()
        raise
    publish_new(path)


def place_of_new(run: Path) -> Path:
    """Where a run is made that replaces `run` when it is complete; no command takes it for a run."""
    return run.parent / ".stages" / run.name


def publish_new(run: Path) -> None:
    """Replace the run by the finished one in `place_of_new`, if there is one; files that are not quadlog's stay.

    To be repeated after a kill: `run.json` says first that the run is unfinished, `config.toml` comes after the earlier
    run is removed, and the new `run.json` last. Raises CannotWrite.
    """
    new = place_of_new(run)
    if not is_finished(new):
        return
    ends = {"config.toml": -1, "run.json": 1}
    try:
        with uninterrupted():
            run.mkdir(exist_ok=True)
            write_record(run, read_record(new), finished=False)
            if (new / "config.toml").is_file():
                remove_own_files(run, keep={"run.json"})
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


def remove_own_files(path: Path, keep: Collection[str] = ()) -> None:
    """Remove pictures and quadlog's other files but those to keep, `run.json` last; links, never what they lead to."""
    plots = path / "plots"
    try:
        if plots.is_dir() and not plots.is_symlink():
            remove_stale_parts(plots)
            for picture in sorted(plots.glob("*.png")):
                picture.unlink(missing_ok=True)
            if not any(plots.iterdir()):
                with suppress(OSError):  # another process is drawing
                    plots.rmdir()
        for name in sorted(OWN_FILES - {*keep}, key=lambda name: (name == "run.json", name)):
            if (path / name).is_symlink() or (path / name).is_file():
                (path / name).unlink(missing_ok=True)
        if plots.is_symlink():
            plots.unlink(missing_ok=True)
    except OSError as error:
        raise CannotWrite(path, error.strerror or str(error)) from error
