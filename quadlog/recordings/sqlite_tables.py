"""The tables of a ROS 2 `.db3`: topics, message definitions, and how many messages there are."""

from __future__ import annotations

import re
import sqlite3
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from quadlog.errors import NotARecording
from quadlog.recordings.bounded import MAX_NAME_BYTES, MAX_TIME_NS
from quadlog.recordings.container import Channel, Loss
from quadlog.recordings.words import ros2_type_name, several
from quadlog.text import clipped

_REQUIRED = {
    "topics": {"id", "name", "type", "serialization_format"},
    "messages": {"id", "topic_id", "timestamp", "data"},
}
_MAX_ROWS = 1 << 20


@dataclass
class Tables:
    """Topic ids of the file to Channels, the span of log times, and what was found wrong on the way."""

    channel_of: dict[int, Channel]
    span_ns: tuple[int, int] | None
    losses: list[Loss] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def read_tables(path: Path, connection: sqlite3.Connection) -> Tables:
    """Raises NotARecording when the database is not that of a ROS 2 bag, or too damaged to tell."""
    try:
        _require_tables(path, connection)
        topics = _rows(connection, "SELECT id, name, type, serialization_format FROM topics ORDER BY id")
    except sqlite3.Error as error:
        raise NotARecording(path, f"SQLite cannot read its tables ({error})") from None
    tables = Tables({}, None)
    definitions = _definitions(connection)
    counts = _counts(connection, tables)
    alike: dict[tuple[str, str, str, str, bytes], list[int]] = {}
    unusable = []
    for number, name, kind, encoding in topics:
        if isinstance(number, int) and all(_is_name(each) for each in (name, kind, encoding)):
            identity = (name, ros2_type_name(kind), encoding, *definitions.get(kind, ("", b"")))
            alike.setdefault(identity, []).append(number)
        else:
            unusable.append(number)
    if unusable:
        first = clipped(repr(unusable[0]))
        detail = f"{several(len(unusable), 'topic')} without a usable name or type, the first has the id {first}"
        tables.losses.append(Loss("damaged", detail))
    for identity, numbers in alike.items():
        count = None if counts is None else sum(counts.get(number, 0) for number in numbers)
        tables.channel_of.update(dict.fromkeys(numbers, Channel(*identity, count=count)))
    orphans = sum(count for number, count in (counts or {}).items() if number not in tables.channel_of)
    if orphans:
        tables.losses.append(Loss("damaged", f"{several(orphans, 'message')} belong to no topic", count=orphans))
    tables.span_ns = _span(connection)
    return tables


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


def _counts(connection: sqlite3.Connection, tables: Tables) -> dict[int, int] | None:
    try:
        return dict(_rows(connection, "SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"))
    except sqlite3.Error as error:
        tables.losses.append(Loss("damaged", f"messages cannot be counted ({error})"))
        return None


def _span(connection: sqlite3.Connection) -> tuple[int, int] | None:
    ends = []
    for which in ("MIN", "MAX"):
        query = f"SELECT {which}(timestamp) FROM messages WHERE timestamp BETWEEN 0 AND {MAX_TIME_NS}"  # noqa: S608
        try:
            ends.append(_rows(connection, query)[0][0])
        except sqlite3.Error:
            return None
    return (ends[0], ends[1]) if all(isinstance(end, int) for end in ends) else None


def _rows(connection: sqlite3.Connection, query: str) -> list[tuple[Any, ...]]:
    return connection.execute(query).fetchmany(_MAX_ROWS)
