"""Files that appear complete or not at all, also after an exception, Ctrl-C or a kill, and beside other writers."""

from __future__ import annotations

import errno
import hashlib
import os
import platform
import re
import secrets
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from quadlog.errors import CannotWrite

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
"""Only writing can fail with these, so they are ours to explain wherever they come from."""
_PART = re.compile(r"\.quadlog-(?P<host>[0-9a-f]{8})-(?P<pid>\d{1,10})-[0-9a-z_]{8}\.part")
_SURELY_LEFT_S = 24 * 3600.0
"""Nobody writes a single file for so long, and clocks of hosts that share a folder differ by less."""
_unfinished: set[Path] = set()
_TRIES = 10


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Write to the path given here; it takes the name `path` when the block ends, and vanishes when it fails.

    The file written to lies in the same folder, so that the rename is one step
    of the file system. A killed process leaves it behind under a name that
    `remove_stale_parts` knows, and the next one that writes into the folder
    removes it; nothing incomplete is ever called `path`. Where two write one file, the last one's is there in the end.

    Raises CannotWrite when the disk is full or the folder cannot be written to.
    """
    check_name(path)
    if path.exists() and not (path.is_file() or path.is_dir()):  # a FIFO, a socket or a device is never replaced
        raise CannotWrite(path, "it is no regular file")
    with _part_in(path.parent, path) as part:
        with writing(path):
            with suppress(OSError):
                remove_stale_parts(part.parent)
            part.open("xb").close()  # nobody's file or link is written through
        yield part
        # Data first, then the name: a power cut must not leave the name without the data.
        with writing(path, gone="its unfinished file, or the folder, was removed by another process"):
            with part.open("rb") as file:
                os.fsync(file.fileno())
            part.replace(path)


@contextmanager
def _part_in(folder: Path, path: Path | None = None) -> Iterator[Path]:
    """The place of a new file or folder, which is removed when the block ends if it still has that name.

    Raises CannotWrite, of the path if given, where the block ends because the disk is full or what was begun is gone.
    """
    part = folder / f"{part_prefix(os.getpid())}{secrets.token_hex(4)}.part"
    _unfinished.add(part)  # before it is there, since a signal may come at any moment
    try:
        yield part
    except OSError as error:
        if is_full(error) or not part.exists():
            raise CannotWrite(path or error.filename or folder, error.strerror or str(error)) from error
        raise
    finally:
        _remove(part)
        _unfinished.discard(part)


@contextmanager
def writing(path: Path, gone: str = "") -> Iterator[None]:
    """What the system refuses within becomes CannotWrite; gone: the reason where the file is not there."""
    try:
        yield
    except OSError as error:
        missing = isinstance(error, FileNotFoundError)
        raise CannotWrite(path, (missing and gone) or error.strerror or str(error)) from error


def write_whole(path: Path, content: bytes) -> None:
    """`content` as the file `path`, whole or not at all. Raises CannotWrite."""
    with whole_file(path) as part:
        part.write_bytes(content)


@contextmanager
def part_folder(parent: Path) -> Iterator[Path]:
    """A folder to fill and to rename; under its first name it vanishes when the block ends, as `whole_file`'s files do.

    Raises CannotWrite.
    """
    check_name(parent)
    with _part_in(parent) as part:
        for _ in range(_TRIES):
            with suppress(FileNotFoundError):  # another process has removed the empty parent
                part.mkdir(parents=True)
                break
        yield part


def _remove(part: Path) -> None:
    if part.is_dir() and not part.is_symlink():
        shutil.rmtree(part, ignore_errors=True)
    else:
        part.unlink(missing_ok=True)


@contextmanager
def new_folder(path: Path) -> Iterator[None]:
    """Make the folder for the block, unless it is there; one that was made goes again if it is empty when that fails.

    Raises CannotWrite.
    """
    check_name(path)
    is_new = not path.exists()
    try:
        with writing(path):
            path.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        with suppress(OSError):  # it holds files, or is not there
            if is_new:
                path.rmdir()
        raise


def remove_unfinished() -> None:
    """Remove what this process had not finished when it was interrupted, wherever that was."""
    for part in tuple(_unfinished):
        with suppress(OSError):
            _remove(part)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold back the signals that end a process until the block is done, for files that belong together.

    Only the main thread can do that; in any other the block is run as it is.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        for number in before:
            signal.signal(number, lambda number, _: held.append(number))
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for each in held:
            signal.raise_signal(each)


def is_full(error: OSError) -> bool:
    """Whether a disk, a quota or the largest size of a file is used up."""
    return error.errno in _FULL


def remove_stale_parts(folder: Path) -> None:
    """Remove what killed runs left in `folder`, as far as that is sure: others may be writing there at this moment."""
    for part in folder.iterdir():
        if is_part(part.name) and _is_left(part):
            _remove(part)


def is_part(name: str) -> bool:
    """Whether a file or folder of this name is one that was not finished."""
    return name.startswith(".quadlog-") and name.endswith(".part")


def part_prefix(pid: int) -> str:
    """How the names of a process's unfinished files begin. Hosts count their processes alike."""
    return f".quadlog-{hashlib.sha256(platform.node().encode()).hexdigest()[:8]}-{pid}-"


def check_name(path: Path) -> None:
    """Raises CannotWrite for a name that neither Parquet nor a page can spell."""
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise CannotWrite(path, "its name is not UTF-8; choose another") from error


def _is_left(part: Path) -> bool:
    """Whether who began the file is gone: a dead process of this host, whatever a clock says; others after a day."""
    found = _PART.fullmatch(part.name)
    if found is not None and part.name.startswith(part_prefix(int(found["pid"]))):
        return not _runs(int(found["pid"]))
    with suppress(OSError):  # gone by itself
        return time.time() - part.lstat().st_mtime > _SURELY_LEFT_S
    return False


def _runs(pid: int) -> bool:
    with suppress(PermissionError):  # of another user
        try:
            os.kill(pid, 0)
        except (ProcessLookupError, OverflowError):
            return False
    return True
