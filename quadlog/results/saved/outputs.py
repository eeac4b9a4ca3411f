"""Files that a command is asked to write: what it may replace."""

from __future__ import annotations

from pathlib import Path

from quadlog.errors import AlreadyExists, CannotWrite, UsageError
from quadlog.results.saved.find_runs import PLOTS, is_run
from quadlog.results.saved.names import OWN_FILES


def refuse_existing(path: Path, force: bool) -> None:
    """Raises AlreadyExists for a file that is there, unless `force`; it replaces regular files alone.

    Raises CannotWrite for a link, a folder, a FIFO or a device, UsageError for a file of a run, there or not.
    """
    folder = path.resolve().parent
    if (path.name in OWN_FILES and is_run(folder)) or (folder.name == PLOTS and is_run(folder.parent)):
        raise UsageError(f"{path} is a file of the run {folder}; choose another place by -o")
    if path.is_symlink() or (path.exists() and not path.is_file()):
        kind = "a link" if path.is_symlink() else "a folder" if path.is_dir() else "no regular file"
        raise CannotWrite(path, f"it is {kind}")
    if path.exists() and not force:
        raise AlreadyExists(path)
