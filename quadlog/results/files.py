"""Files that appear whole or not at all, also after an exception, Ctrl-C or a kill."""

from __future__ import annotations

import errno
import itertools
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from quadlog.errors import CannotWrite

# Only writing can fail with these, so they are ours to explain wherever they come from.
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_numbers = itertools.count()


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Write to the path given here; it takes the name `path` when the block ends, and vanishes when it fails.

    The file written to lies in the same folder, so that the rename is one step
    of the file system. A killed process leaves it behind under a name that
    `remove_stale_parts` knows; nothing incomplete is ever called `path`.

    Raises CannotWrite when the disk is full or the folder cannot be written to.
    """
    try:
        part = _create_part(path.parent)
    except OSError as error:
        raise CannotWrite(path, error.strerror or str(error)) from error
    try:
        yield part
        _publish(part, path)
    except BaseException as error:
        part.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno in _FULL:
            raise CannotWrite(path, os.strerror(error.errno)) from error
        raise


def write_whole(path: Path, content: bytes) -> None:
    """`content` as the file `path`, whole or not at all. Raises CannotWrite."""
    with whole_file(path) as part:
        part.write_bytes(content)


def remove_stale_parts(folder: Path) -> None:
    """Remove what killed runs left in `folder`; no other run may be writing there."""
    for part in folder.iterdir():
        if is_part(part.name) and (part.is_symlink() or part.is_file()):
            part.unlink(missing_ok=True)


def is_part(name: str) -> bool:
    """Whether a file of this name is one that `whole_file` had not finished."""
    return name.startswith(".quadlog-") and name.endswith(".part")


def _create_part(folder: Path) -> Path:
    """A new empty file of our own; O_EXCL, so that nobody's file or link is written through."""
    while True:
        part = folder / f".quadlog-{os.getpid()}-{next(_numbers)}.part"
        try:
            os.close(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        except FileExistsError:
            continue
        return part


def _publish(part: Path, path: Path) -> None:
    """Data first, then the name: a power cut must not leave the name without the data."""
    try:
        handle = os.open(part, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
        part.replace(path)
    except OSError as error:
        raise CannotWrite(path, error.strerror or str(error)) from error
