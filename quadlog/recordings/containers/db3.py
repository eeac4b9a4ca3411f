"""A ROS 2 bag's SQLite file (.db3), read whole; nothing is written beside it.

A database in WAL mode cannot be opened where it lies: SQLite would write a
`-shm` beside it, and without that it ignores what stands in the `-wal` only.
So a database with pending changes is copied, changes and all, and opened there;
so is one that was cut off in the middle of a page. SQLite keeps the changes
beside the file itself, not beside a link to it.
"""

from __future__ import annotations

import os
import re
import sqlite3
import tempfile
from array import array
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack
from copy import copy as copied
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from quadlog.errors import NotARecording, NothingReadable, clipped
from quadlog.recordings.containers.container import (
    JUMP_NS,
    MAX_CHUNK_BYTES,
    MAX_NAME_BYTES,
    MAX_TIME_NS,
    Budget,
    Channel,
    Container,
    Damaged,
    Identity,
    LogTimes,
    Loss,
    RawMessage,
    places_within,
    shared_channels,
    spread,
)
from quadlog.recordings.formatting import ros2_type_name, several
from quadlog.storage.byte_source import fill

MAGIC = b"SQLite format 3\0"
_FAILURES = (sqlite3.Error, OverflowError, MemoryError)
_REQUIRED = {
    "topics": {"id", "name", "type", "serialization_format"},
    "messages": {"id", "topic_id", "timestamp", "data"},
}
_MAX_ROWS = 1 << 20
_AT_ONCE = 1 << 14
# Row ids at a time, and how often at most, in which the end of a damaged stretch is looked for.
_PROBE, _MAX_PROBES = 16, 1 << 12
_KEY = (
    f"SELECT CASE WHEN typeof(timestamp) = 'integer' AND timestamp BETWEEN 0 AND {MAX_TIME_NS} THEN timestamp ELSE -1 "  # noqa: S608
    "END, rowid, CASE WHEN typeof(topic_id) = 'integer' THEN topic_id ELSE -1 END "
    "FROM messages NOT INDEXED WHERE rowid >= ? ORDER BY rowid"
)


def _pending_changes(path: Path) -> dict[str, Path]:
    """`-wal` and `-journal` with something in them, by suffix: beside the file itself, else beside the link to it."""
    pending = {}
    for suffix in ("-wal", "-journal"):
        places = (each.with_name(each.name + suffix) for each in (path.resolve(), path))
        found = next((place for place in places if place.is_file() and place.stat().st_size > 0), None)
        if found is not None:
            pending[suffix] = found
    return pending


def _measure(path: Path) -> tuple[int, int]:
    """The size of a page, and how many bytes the file is shorter than its header declares."""
    with path.open("rb") as file:
        header = file.read(100)
    page_bytes = int.from_bytes(header[16:18], "big")
    page_bytes = 65536 if page_bytes == 1 else max(page_bytes, 512)
    return page_bytes, max(0, page_bytes * int.from_bytes(header[28:32], "big") - path.stat().st_size)


class SqliteReader(Container):
    """The `.db3` at a place, which is known by its path.

    Messages come one by one in order of (timestamp, row id), by keys that opening reads in one scan, payloads unread; a
    damaged row costs itself, not those behind it. Raises NotARecording when it is not a ROS 2 bag, NothingReadable when
    no message can be read, TooLarge when a copy is needed and there is no room.
    """

    def __init__(self, path: Path, place: Path, warnings: Sequence[str] = ()) -> None:
        super().__init__(path, warnings)
        with ExitStack() as on_error:
            on_error.push(self)
            self._open(place)
            on_error.pop_all()

    def _open(self, place: Path) -> None:
        """Read topics and keys."""
        self._database = self._connect(place)
        identities = self._read_topics()
        # (N, 3): log time, row id and topic id; -1 for a time or a topic that is not usable.
        keys = np.frombuffer(self._read_keys(), np.int64).reshape(-1, 3)
        counts = Counter(keys[:, 2].tolist())
        self._channel_of = shared_channels((n, identity, counts[n]) for n, identity in identities)
        self.channels = tuple(dict.fromkeys(self._channel_of.values()))
        if orphans := sum(count for number, count in counts.items() if number not in self._channel_of):
            self._losses.append(Loss("damaged", f"{several(orphans, 'message')} belong to no topic", count=orphans))
        keys = keys[keys[:, 0] >= 0]
        known, usable = Counter(keys[:, 2].tolist()), Counter[Channel]()
        for number, channel in self._channel_of.items():
            usable[channel] += known[number]
        for channel, count in usable.items():
            if missing := channel.count - count:
                detail = f"{channel.count} rows, of which {missing} have no usable time or could not be reached"
                self._losses.append(Loss("count", detail, channel.topic, missing))
        t_ns = keys[:, 0]
        self.span_ns = (int(t_ns.min()), int(t_ns.max())) if len(t_ns) else None
        if (back_ns := int((np.maximum.accumulate(t_ns) - t_ns).max(initial=0))) > JUMP_NS:
            back_s = back_ns / 1e9
            self._warnings.append(
                f"log time goes back in the file, by up to {back_s:.3f} s; messages come in order of log time"
            )
        self._keys = keys[np.argsort(t_ns, kind="stable")]
        self._refuse_foreign_encodings()

    def _connect(self, place: Path) -> sqlite3.Connection:
        pending = _pending_changes(place)
        page_bytes, missing_bytes = _measure(place)
        self._size = place.stat().st_size
        if missing_bytes and not pending:
            self._losses.append(Loss("truncated", f"the last {several(missing_bytes, 'byte')} are missing"))
        where, parameters = str(place.resolve()), "mode=ro&immutable=1"
        if pending or (missing_bytes and self._size % page_bytes):
            where, parameters = self._copied(place, pending), "mode=rw"
            if pending:
                names = " and ".join(source.name for source in pending.values())
                self._warnings.append(
                    f"{names} holds changes that {place.name} does not have yet; both were copied and read together"
                )
            else:
                # SQLite would fill the torn page with zeros and give those out as data.
                os.truncate(where, self._size // page_bytes * page_bytes)
        # Immutable: no locks, no -shm, and nobody else's changes, because there are none.
        try:
            database = sqlite3.connect(f"file:{quote(where)}?{parameters}", uri=True)
            self.resources.callback(database.close)
            database.text_factory = lambda raw: raw.decode("utf-8", "replace")
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK_BYTES)
            # Whoever wrote the file wrote its schema too: no functions, no views' tricks. writable_schema lets SQLite
            # read what is left of a file that was cut off; the file itself is open for reading only.
            for pragma in ("trusted_schema=OFF", "cell_size_check=ON", "writable_schema=ON", "query_only=ON"):
                database.execute(f"PRAGMA {pragma}")
        except sqlite3.Error as error:
            raise NotARecording(self.path, f"SQLite cannot open it ({error})") from None
        return database

    def _copied(self, place: Path, pending: dict[str, Path]) -> str:
        copy = Path(self.resources.enter_context(tempfile.TemporaryDirectory(prefix="quadlog-"))) / "copy.db3"
        sources = {"": place, **pending}
        for suffix, source in sources.items():
            with source.open("rb") as file:
                fill(Path(f"{copy}{suffix}"), iter(partial(file.read, 1 << 20), b""), self.path, source.stat().st_size)
        return str(copy)

    def _rows(self, query: str) -> list[tuple[Any, ...]]:
        return self._database.execute(query).fetchmany(_MAX_ROWS)

    def _read_topics(self) -> list[tuple[int, Identity]]:
        """Topic ids and what they are. Raises NotARecording for what is no ROS 2 bag, or too damaged to tell."""
        try:
            self._require_tables()
            topics = self._rows("SELECT id, name, type, serialization_format FROM topics ORDER BY id")
        except sqlite3.Error as error:
            raise NotARecording(self.path, f"SQLite cannot read its tables ({error})") from None
        try:  # bags before ROS 2 Iron have none
            known = self._rows("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
        except sqlite3.Error:
            known = []
        known = [row for row in known if all(isinstance(each, str) for each in row) and row[2]]
        definitions = {row[0]: (row[1], row[2].encode()) for row in known if row[1] in ("ros2msg", "ros2idl")}
        identities: list[tuple[int, Identity]] = []
        unusable = []
        for number, *names in topics:
            if isinstance(number, int) and all(isinstance(each, str) and len(each) <= MAX_NAME_BYTES for each in names):
                name, kind, encoding = names
                identities.append((number, (name, ros2_type_name(kind), encoding, *definitions.get(kind, ("", b"")))))
            else:
                unusable.append(number)
        if unusable:
            first = clipped(repr(unusable[0]))
            detail = f"{several(len(unusable), 'topic')} without a usable name or type, the first has the id {first}"
            self._losses.append(Loss("damaged", detail))
        return identities

    def _require_tables(self) -> None:
        # A view or virtual table of that name could run anything, forever.
        found = dict(self._rows("SELECT name, sql FROM sqlite_master WHERE type = 'table'"))
        for table, columns in _REQUIRED.items():
            if not re.match(r"create\s+table\b", str(found.get(table, "")), re.IGNORECASE):
                raise NotARecording(self.path, f"an SQLite database without the table {table!r} of a ROS 2 bag")
            # A generated column is an expression of the file's, and rowid must be SQLite's own: rows are found by it.
            rows = self._rows(f"PRAGMA table_xinfo({table})")
            if any(str(row[1]).lower() == "rowid" for row in rows):
                raise NotARecording(self.path, f"its table {table!r} has a column named rowid, which no ROS 2 bag has")
            if missing := ", ".join(sorted(columns - {row[1] for row in rows if row[6] == 0})):
                raise NotARecording(self.path, f"its table {table!r} lacks what a ROS 2 bag has: {missing}")

    def _read_keys(self) -> array[int]:
        """Time, row id and topic of every row that can be reached, in file order."""
        values, start = array("q"), -(2**63)
        self._probes = min(_MAX_PROBES, self._size >> 8)
        while True:
            try:
                for row in self._database.execute(_KEY, (start,)):
                    values.extend(row)
                return values
            except _FAILURES as error:
                self._losses.append(
                    Loss("damaged", f"rows cannot be reached ({error}); those behind them were searched for")
                )
            behind = self._behind_damage(max(start, values[-2] if values else 0))
            if behind is None:
                return values
            start = behind

    def _behind_damage(self, row_id: int) -> int | None:
        """The first row id beyond this one from which rows can be reached; None where there is none."""
        step = 1
        while not self._can_reach(row_id + step):
            if self._probes <= 0:
                return None
            row_id, step = row_id + step, min(2 * step, _PROBE)
        while step > 1:
            step //= 2
            if not self._can_reach(row_id + step):
                row_id += step
        return row_id + 1

    def _can_reach(self, row_id: int) -> bool:
        self._probes -= 1
        try:
            self._database.execute(f"{_KEY} LIMIT 1", (row_id,)).fetchone()
        except _FAILURES:
            return False
        return True

    def _refuse_foreign_encodings(self) -> None:
        """Names every topic that is not CDR. Raises NothingReadable when that leaves no message."""
        used = [channel for channel in self.channels if channel.count]
        foreign = [channel for channel in used if channel.message_encoding != "cdr"]
        for channel in foreign:
            detail = f"its messages are serialised as {channel.message_encoding!r}, which quadlog does not read (cdr)"
            self._losses.append(Loss("serialization", detail, channel.topic, channel.count))
        if foreign and len(foreign) == len(used):
            raise NothingReadable(self.path, f"{foreign[0].topic}: {self.losses[-1].detail}")

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """See Container. Messages that are not CDR are left out: opening already reported them."""
        wanted = {
            number: channel
            for number, channel in self._channel_of.items()
            if channel.message_encoding == "cdr" and (topics is None or channel.topic in topics)
        }
        read, damaged = Counter[Channel](), Counter[Channel]()
        query = "SELECT data FROM messages WHERE rowid = ?"
        for t_ns, row_id, number in self._chosen(wanted, start_ns, end_ns):
            try:
                row = self._database.execute(query, (row_id,)).fetchone()
            except _FAILURES:
                row = None
            if row is None or not isinstance(row[0], bytes):
                damaged[wanted[number]] += 1
                continue
            read[wanted[number]] += 1
            yield RawMessage(wanted[number], t_ns, row[0])
        for channel, count in damaged.items():
            self._losses.append(Loss("damaged", f"{several(count, 'row')} cannot be read", channel.topic, count))
        if damaged and not read and topics is None and start_ns is None and end_ns is None:
            raise NothingReadable(self.path, f"no message of {several(damaged.total(), 'row')} can be read")

    def _chosen(self, wanted: Collection[int], start_ns: int | None, end_ns: int | None) -> Iterator[list[int]]:
        """Keys of the messages of these topics with start_ns <= log time < end_ns, in order."""
        t_ns = self._keys[:, 0]
        begin = 0 if start_ns is None else t_ns.searchsorted(min(start_ns, MAX_TIME_NS))
        end = None if end_ns is None or end_ns > MAX_TIME_NS else t_ns.searchsorted(end_ns)
        keys = self._keys[begin:end]
        keys = keys[np.isin(keys[:, 2], list(wanted))]
        for at in range(0, len(keys), _AT_ONCE):
            yield from keys[at : at + _AT_ONCE].tolist()

    def log_times(self) -> Iterator[LogTimes]:
        """See Container."""
        if self.losses:
            raise Damaged(self.losses[0].detail)
        for number, channel in self._channel_of.items():
            yield LogTimes(channel, self._keys[self._keys[:, 2] == number, 0])

    def excerpt(self, budget: Budget) -> SqliteReader | None:
        """See Container. A place is some rows that were written one after the other."""
        messages = len(self._keys)
        if places_within(budget, budget.places, self._size, messages) is None:
            return None
        rows_of_budget = min(budget.messages, budget.stored_bytes * messages // max(self._size, 1))
        rows = max(rows_of_budget // max(budget.places, 1), 1)
        in_file = np.argsort(self._keys[:, 1])
        chosen = [in_file[place : place + rows] for place in spread(messages, budget.places)]
        excerpt = copied(self)
        excerpt._keys = self._keys[np.unique(np.concatenate([np.empty(0, np.int64), *chosen]))]
        return excerpt
