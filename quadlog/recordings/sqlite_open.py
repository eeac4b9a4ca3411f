"""Opening an SQLite file that must be read whole and beside which nothing may be written.

A database in WAL mode cannot be opened where it lies: SQLite would write a
`-shm` beside it, and without that it ignores what stands in the `-wal` only.
So a database with pending changes is copied, changes and all, and opened there;
so is one that was cut off in the middle of a page. SQLite keeps the changes
beside the file itself, not beside a link to it.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import tempfile
from pathlib import Path
from urllib.parse import quote

from quadlog.errors import NotARecording, TooLarge
from quadlog.recordings.bounded import MAX_CHUNK_BYTES

MAGIC = b"SQLite format 3\0"
_PENDING = ("-wal", "-journal")


class OpenDatabase:
    """A database that is connected to while it is needed.

    folder is that of its copy, if there is one; warnings what a user should know about it.
    """

    def __init__(
        self,
        path: Path,
        parameters: str,
        folder: tempfile.TemporaryDirectory | None,
        warnings: list[str],
        missing_bytes: int,
    ) -> None:
        self.folder, self.warnings, self.missing_bytes = folder, warnings, missing_bytes
        self._path, self._parameters = path, parameters
        self._connection: sqlite3.Connection | None = _connect(path, parameters)
        self._is_closed = False

    @property
    def connection(self) -> sqlite3.Connection:
        """Made again when it was released. Raises NotARecording when that fails."""
        if self._connection is None:
            if self._is_closed:
                raise ValueError("a closed database is read")
            self._connection = _connect(self._path, self._parameters)
        return self._connection

    def release(self) -> None:
        """Give the file descriptor back; nothing may be reading."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def close(self) -> None:
        self.release()
        self._is_closed = True
        if self.folder is not None:
            self.folder.cleanup()


def open_database(path: Path) -> OpenDatabase:
    """Opens a database for reading. Raises NotARecording, or TooLarge when a copy is needed and there is no room.

    missing_bytes says how much shorter the file is than its header declares.
    """
    pending = _pending_changes(path)
    page_bytes, missing_bytes = _measure(path)
    torn = missing_bytes > 0 and path.stat().st_size % page_bytes != 0
    if not pending and not torn:
        # Immutable: no locks, no -shm, and nobody else's changes, because there are none.
        return OpenDatabase(path, "mode=ro&immutable=1", None, [], missing_bytes)
    folder = _copy(path, pending)
    copy = Path(folder.name) / "copy.db3"
    warnings = []
    if pending:
        names = " and ".join(source.name for source in pending.values())
        warnings = [f"{names} holds changes that {path.name} does not have yet; both were copied and read together"]
    else:
        # SQLite would fill the torn page with zeros and give those out as data.
        os.truncate(copy, copy.stat().st_size // page_bytes * page_bytes)
    try:
        return OpenDatabase(copy, "mode=rw", folder, warnings, 0 if pending else missing_bytes)
    except BaseException:
        folder.cleanup()
        raise


def _pending_changes(path: Path) -> dict[str, Path]:
    """`-wal` and `-journal` with something in them, by suffix: beside the file itself, else beside the link to it."""
    pending = {}
    for suffix in _PENDING:
        places = (each.with_name(each.name + suffix) for each in (path.resolve(), path))
        found = next((place for place in places if _has_bytes(place)), None)
        if found is not None:
            pending[suffix] = found
    return pending


def _has_bytes(path: Path) -> bool:
    return path.is_file() and path.stat().st_size > 0


def _copy(path: Path, pending: dict[str, Path]) -> tempfile.TemporaryDirectory:
    sources = {"": path, **pending}
    folder = tempfile.TemporaryDirectory(prefix="quadlog-")
    try:
        needed = sum(source.stat().st_size for source in sources.values())
        free = shutil.disk_usage(folder.name).free
        with_pending = "".join(f" with its {suffix}" for suffix in pending)
        if needed > free:
            raise TooLarge(f"{path}: copying it{with_pending} to {tempfile.gettempdir()}", needed, free)
        for suffix, source in sources.items():
            shutil.copyfile(source, Path(folder.name) / f"copy.db3{suffix}")
    except BaseException:
        folder.cleanup()
        raise
    return folder


def _connect(path: Path, parameters: str) -> sqlite3.Connection:
    try:
        connection = sqlite3.connect(f"file:{quote(str(path.resolve()))}?{parameters}", uri=True)
        connection.text_factory = lambda raw: raw.decode("utf-8", "replace")
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK_BYTES)
        # Whoever wrote the file wrote its schema too: no functions, no views' tricks.
        connection.execute("PRAGMA trusted_schema=OFF")
        connection.execute("PRAGMA cell_size_check=ON")
        # Lets SQLite read what is left of a file that was cut off; the file itself is open for reading only.
        connection.execute("PRAGMA writable_schema=ON")
        connection.execute("PRAGMA query_only=ON")
    except sqlite3.Error as error:
        raise NotARecording(path, f"SQLite cannot open it ({error})") from None
    return connection


def _measure(path: Path) -> tuple[int, int]:
    """The size of a page, and how many bytes the file is shorter than its header declares."""
    with path.open("rb") as file:
        header = file.read(100)
    page_bytes = int.from_bytes(header[16:18], "big")
    page_bytes = 65536 if page_bytes == 1 else max(page_bytes, 512)
    return page_bytes, max(0, page_bytes * int.from_bytes(header[28:32], "big") - path.stat().st_size)
