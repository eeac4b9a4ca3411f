"""A ROS 2 bag's SQLite file (.db3), read whole; nothing is written beside it.

A database in WAL mode cannot be opened where it lies: SQLite would write a
`-shm` beside it, and without that it ignores what stands in the `-wal` only.
So a database with pending changes is copied, changes and all, and opened there;
so is one that was cut off in the middle of a page. SQLite keeps the changes
beside the file itself, not beside a link to it.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Collection, Iterator
from copy import copy
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from quadlog.errors import NotARecording, NothingReadable, TooLarge, clipped
from quadlog.recordings.containers.bounded_reader import MAX_CHUNK_BYTES, MAX_NAME_BYTES, MAX_TIME_NS, Damaged
from quadlog.recordings.containers.chunks import JUMP_NS
from quadlog.recordings.containers.container import (
    Budget,
    Channel,
    ClosedOnExit,
    Identity,
    LogTimes,
    Loss,
    RawMessage,
    places_within,
    shared_channels,
    spread,
)
from quadlog.recordings.formatting import ros2_type_name, several

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
        found = next((place for place in places if place.is_file() and place.stat().st_size > 0), None)
        if found is not None:
            pending[suffix] = found
    return pending


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


_REQUIRED = {
    "topics": {"id", "name", "type", "serialization_format"},
    "messages": {"id", "topic_id", "timestamp", "data"},
}
_MAX_ROWS = 1 << 20


def _is_name(value: object) -> bool:
    return isinstance(value, str) and len(value) <= MAX_NAME_BYTES


def _require_tables(path: Path, connection: sqlite3.Connection) -> None:
    # A view or virtual table of that name could run anything, forever.
    found = dict(_rows(connection, "SELECT name, sql FROM sqlite_master WHERE type = 'table'"))
    for table, columns in _REQUIRED.items():
        if not re.match(r"create\s+table\b", str(found.get(table, "")), re.IGNORECASE):
            raise NotARecording(path, f"an SQLite database without the table {table!r} of a ROS 2 bag")
        # A generated column is an expression of the file's, and rowid must be SQLite's own: rows are found by it.
        rows = _rows(connection, f"PRAGMA table_xinfo({table})")
        present = {row[1] for row in rows if row[6] == 0}
        if any(str(row[1]).lower() == "rowid" for row in rows):
            raise NotARecording(path, f"its table {table!r} has a column named rowid, which no ROS 2 bag has")
        if not columns <= present:
            missing = ", ".join(sorted(columns - present))
            raise NotARecording(path, f"its table {table!r} lacks what a ROS 2 bag has: {missing}")


def _definitions(connection: sqlite3.Connection) -> dict[str, tuple[str, bytes]]:
    """Type name to encoding and text of its definition; bags before ROS 2 Iron have none."""
    query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
    try:
        rows = _rows(connection, query)
    except sqlite3.Error:
        return {}
    known = [row for row in rows if all(isinstance(each, str) for each in row) and row[1] in ("ros2msg", "ros2idl")]
    return {kind: (encoding, definition.encode()) for kind, encoding, definition in known if definition}


def _span_ns(connection: sqlite3.Connection) -> tuple[int, int] | None:
    """The smallest and the largest log time, None where no row has one or the file is damaged."""
    query = f"SELECT {{}}(timestamp) FROM messages WHERE timestamp BETWEEN 0 AND {MAX_TIME_NS}"  # noqa: S608
    try:
        first_ns, last_ns = (_rows(connection, query.format(each))[0][0] for each in ("MIN", "MAX"))
    except sqlite3.Error:
        return None
    return (first_ns, last_ns) if isinstance(first_ns, int) and isinstance(last_ns, int) else None


def _clock_warnings(connection: sqlite3.Connection) -> list[str]:
    """No warning or one: rows that were written after rows more than a second later in time."""
    query = (
        "SELECT MAX(latest - timestamp) FROM "  # noqa: S608
        "(SELECT timestamp, MAX(timestamp) OVER (ORDER BY rowid ROWS UNBOUNDED PRECEDING) AS latest "
        f"FROM messages NOT INDEXED WHERE timestamp BETWEEN 0 AND {MAX_TIME_NS})"
    )
    try:
        back_ns = _rows(connection, query)[0][0] or 0
    except sqlite3.Error:
        return []
    if back_ns <= JUMP_NS:
        return []
    return [f"log time goes back in the file, by up to {back_ns / 1e9:.3f} s; messages come in order of log time"]


def _rows(connection: sqlite3.Connection, query: str) -> list[tuple[Any, ...]]:
    return connection.execute(query).fetchmany(_MAX_ROWS)


_BATCH_ROWS = 1 << 14


def _row(connection: sqlite3.Connection, row_id: int) -> tuple[int, bytes] | None:
    """Log time and payload of a message, None where it is damaged."""
    try:
        row = connection.execute("SELECT timestamp, data FROM messages WHERE rowid = ?", (row_id,)).fetchone()
    except (sqlite3.Error, OverflowError, MemoryError):
        return None
    if row is None or not isinstance(row[0], int) or not isinstance(row[1], bytes):
        return None
    return row


def open_sqlite(path: Path) -> SqliteReader:
    """Opens a `.db3`. Raises NotARecording when it is not a ROS 2 bag, NothingReadable when no message can be read."""
    database = open_database(path)
    try:
        return SqliteReader(path, database)
    except BaseException:
        database.close()
        raise


class SqliteReader(ClosedOnExit):
    """Reads messages one by one in order of (timestamp, id); a damaged row costs itself, not those behind it."""

    def __init__(self, path: Path, database: OpenDatabase) -> None:
        self.path, self.close = path, database.close
        self.losses: list[Loss] = []
        if database.missing_bytes:
            self._report(Loss("truncated", f"the last {several(database.missing_bytes, 'byte')} are missing"))
        self._database = database
        self._passes = 0
        # Of an excerpt: row ids at which its places begin, and the rows of each.
        self._places: list[int] | None = None
        self._rows_of_place = 0
        self._channel_of = self._read_topics()
        self.channels = tuple(dict.fromkeys(self._channel_of.values()))
        self.span_ns = _span_ns(self._connection)
        self.warnings = database.warnings + _clock_warnings(self._connection)
        self._refuse_foreign_encodings()

    def _read_topics(self) -> dict[int, Channel]:
        """Topic ids to Channels. Raises NotARecording when the file is not a ROS 2 bag, or too damaged to tell."""
        try:
            _require_tables(self.path, self._connection)
            query = "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
            topics = _rows(self._connection, query)
        except sqlite3.Error as error:
            raise NotARecording(self.path, f"SQLite cannot read its tables ({error})") from None
        definitions = _definitions(self._connection)
        counts: dict[int, int] | None = None
        try:
            counts = dict(_rows(self._connection, "SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"))
        except sqlite3.Error as error:
            self._report(Loss("damaged", f"messages cannot be counted ({error})"))
        identities: list[tuple[int, Identity]] = []
        unusable = []
        for number, name, kind, encoding in topics:
            if isinstance(number, int) and all(_is_name(each) for each in (name, kind, encoding)):
                identities.append((number, (name, ros2_type_name(kind), encoding, *definitions.get(kind, ("", b"")))))
            else:
                unusable.append(number)
        if unusable:
            first = clipped(repr(unusable[0]))
            detail = f"{several(len(unusable), 'topic')} without a usable name or type, the first has the id {first}"
            self._report(Loss("damaged", detail))
        channel_of = shared_channels(identities, lambda number: None if counts is None else counts.get(number, 0))
        orphans = sum(count for number, count in (counts or {}).items() if number not in channel_of)
        if orphans:
            self._report(Loss("damaged", f"{several(orphans, 'message')} belong to no topic", count=orphans))
        return channel_of

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """See Container. Messages that are not CDR are left out: opening already reported them."""
        wanted = {
            number: channel
            for number, channel in self._channel_of.items()
            if channel.message_encoding == "cdr" and (topics is None or channel.topic in topics)
        }
        read: Counter[int] = Counter()
        damaged: Counter[int] = Counter()
        connection = self._connection
        self._passes += 1
        try:
            for number, row_id in self._keys(sorted(wanted), start_ns, end_ns):
                row = _row(connection, row_id)
                if row is None:
                    damaged[number] += 1
                    continue
                read[number] += 1
                yield RawMessage(wanted[number], *row)
        finally:
            self._passes -= 1
        is_whole = start_ns is None and end_ns is None
        for channel, count in self._by_channel(damaged).items():
            self._report(Loss("damaged", f"{several(count, 'row')} cannot be read", channel.topic, count))
        if damaged and not read and topics is None and is_whole:
            raise NothingReadable(self.path, f"no message of {several(damaged.total(), 'row')} can be read")
        if is_whole and self._places is None:
            self._compare_counts(set(wanted.values()), self._by_channel(read + damaged))

    def _by_channel(self, counts: Counter[int]) -> Counter[Channel]:
        total: Counter[Channel] = Counter()
        for number, count in counts.items():
            total[self._channel_of[number]] += count
        return total

    def log_times(self) -> Iterator[LogTimes]:
        """See Container. A walk over the table: payloads that do not fit beside their row are not touched."""
        if self.losses:
            raise Damaged(self.losses[0].detail)
        return self._listed_times()

    def _listed_times(self) -> Iterator[LogTimes]:
        query = (
            "SELECT topic_id, timestamp FROM messages "  # noqa: S608
            f"WHERE timestamp BETWEEN 0 AND {MAX_TIME_NS} ORDER BY timestamp, rowid"
        )
        tally: Counter[Channel] = Counter()
        try:
            cursor = self._connection.execute(query)
            while rows := cursor.fetchmany(_BATCH_ROWS):
                numbers, t_ns = np.array(rows, np.int64).T
                for number in np.unique(numbers).tolist():
                    channel = self._channel_of[number]
                    times = LogTimes(int(t_ns[0]), channel, t_ns[numbers == number])
                    tally[channel] += len(times.t_ns)
                    yield times
        except (sqlite3.Error, OverflowError, ValueError, TypeError, KeyError) as error:
            raise Damaged(f"the rows cannot be listed ({error})") from None
        if any((channel.count or 0) != tally[channel] for channel in self.channels):
            raise Damaged("not every row has a usable time")

    def excerpt(self, budget: Budget) -> SqliteReader | None:
        """See Container. A place is some rows that were written one after the other."""
        messages = sum(channel.count or 0 for channel in self.channels)
        first, last, stored_bytes = self._extent()
        if places_within(budget, budget.places, stored_bytes, messages) is None:
            return None
        rows_of_budget = min(budget.messages, budget.stored_bytes * messages // max(stored_bytes, 1))
        excerpt = copy(self)
        excerpt._places = [first + index for index in spread(last - first + 1, budget.places)]
        excerpt._rows_of_place = max(rows_of_budget // max(budget.places, 1), 1)
        return excerpt

    def _extent(self) -> tuple[int, int, int]:
        """The first and the last row id, and the bytes of the file."""
        # The ends in two queries: for both at once SQLite would walk the table.
        queries = (
            "SELECT MIN(rowid) FROM messages",
            "SELECT MAX(rowid) FROM messages",
            "PRAGMA page_count",
            "PRAGMA page_size",
        )
        try:
            first, last, pages, page_bytes = (self._connection.execute(query).fetchone()[0] for query in queries)
        except sqlite3.Error:
            return 0, 0, 0
        return first or 0, last or 0, pages * page_bytes

    def release(self) -> None:
        if self._passes == 0:
            self._database.release()

    @property
    def _connection(self) -> sqlite3.Connection:
        return self._database.connection

    def _keys(self, numbers: list[int], start_ns: int | None, end_ns: int | None) -> Iterator[tuple[int, int]]:
        """Topic and row id of each message in order of log time; in file order behind a damage of the time index."""
        chosen = json.dumps(numbers), 0 if start_ns is None else start_ns, MAX_TIME_NS if end_ns is None else end_ns - 1
        among = "topic_id IN (SELECT value FROM json_each(?)) AND timestamp BETWEEN ? AND ?"
        last = (-1, -1)
        if self._places is not None:
            yield from self._excerpted_keys(among, chosen)
            return
        try:
            # Row by row and without the payload, so that sorting stays small where there is no time index.
            query = f"SELECT topic_id, rowid, timestamp FROM messages WHERE {among} ORDER BY timestamp, rowid"  # noqa: S608
            for number, row_id, t_ns in self._connection.execute(query, chosen):
                last = (t_ns, row_id)
                yield number, row_id
        except (sqlite3.Error, OverflowError) as error:
            self._report(
                Loss("damaged", f"the order of messages is damaged ({error}); the rest was read in file order")
            )
            rest = f"SELECT topic_id, rowid FROM messages NOT INDEXED WHERE {among} AND (timestamp, rowid) > (?, ?)"  # noqa: S608
            try:
                yield from self._connection.execute(rest, (*chosen, *last))
            except (sqlite3.Error, OverflowError) as second:
                self._report(Loss("truncated", f"reading ended early ({second})"))

    def _excerpted_keys(self, among: str, chosen: tuple[str, int, int]) -> list[tuple[int, int]]:
        """Topic and row id of each message of an excerpt, in order of log time."""
        place = "SELECT topic_id, rowid, timestamp FROM messages WHERE rowid >= ? ORDER BY rowid LIMIT ?"
        query = f"SELECT timestamp, rowid, topic_id FROM ({place}) WHERE {among}"  # noqa: S608
        keys: set[tuple[int, int, int]] = set()
        try:
            for first in self._places or ():
                keys.update(self._connection.execute(query, (first, self._rows_of_place, *chosen)))
        except (sqlite3.Error, OverflowError) as error:
            self._report(Loss("damaged", f"rows cannot be reached ({error})"))
        return [(number, row_id) for _, row_id, number in sorted(keys)]

    def _refuse_foreign_encodings(self) -> None:
        """Names every topic that is not CDR. Raises NothingReadable when that leaves no message."""
        foreign = [channel for channel in self.channels if channel.message_encoding != "cdr" and channel.count != 0]
        for channel in foreign:
            detail = f"its messages are serialised as {channel.message_encoding!r}, which quadlog does not read (cdr)"
            self._report(Loss("serialization", detail, channel.topic, channel.count))
        if foreign and len(foreign) == sum(channel.count != 0 for channel in self.channels):
            raise NothingReadable(self.path, f"{foreign[0].topic}: {self.losses[-1].detail}")

    def _compare_counts(self, wanted: set[Channel], had: Counter[Channel]) -> None:
        for channel in self.channels:
            if channel in wanted and channel.count is not None and channel.count > had[channel]:
                missing = channel.count - had[channel]
                detail = f"{channel.count} rows, of which {missing} have no usable time or could not be reached"
                self._report(Loss("count", detail, channel.topic, missing))

    def _report(self, loss: Loss) -> None:
        if loss not in self.losses:
            self.losses.append(loss)
