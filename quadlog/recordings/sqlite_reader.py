"""ROS 2 bags in SQLite (`.db3`). The format has no checksums: only what breaks a page or a row can be seen."""

from __future__ import annotations

import json
import sqlite3
from collections import Counter, deque
from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType

from quadlog.errors import NothingReadable
from quadlog.recordings.bounded import MAX_TIME_NS
from quadlog.recordings.container import Channel, Loss, RawMessage
from quadlog.recordings.sqlite_open import OpenDatabase, open_database
from quadlog.recordings.sqlite_tables import Tables, read_tables
from quadlog.recordings.words import several

_SECOND_NS = 10**9


def open_sqlite(path: Path) -> SqliteReader:
    """Opens a `.db3`. Raises NotARecording when it is not a ROS 2 bag, NothingReadable when no message can be had."""
    database = open_database(path)
    try:
        return SqliteReader(path, database, read_tables(path, database.connection))
    except BaseException:
        database.close()
        raise


class SqliteReader:
    """Reads messages one by one in order of (timestamp, id); a damaged row costs itself, not those behind it."""

    def __init__(self, path: Path, database: OpenDatabase, tables: Tables) -> None:
        self.path = path
        self.losses: list[Loss] = []
        if database.missing_bytes:
            self.losses.append(Loss("truncated", f"the last {several(database.missing_bytes, 'byte')} are missing"))
        self.losses += tables.losses
        self.warnings: list[str] = [*database.warnings, *tables.warnings]
        self.close = database.close
        self._database, self._tables = database, tables
        self._passes = 0
        self._is_copy = database.folder is not None
        self._channels = tuple(dict.fromkeys(tables.channel_of.values()))
        self._refuse_foreign_encodings()

    @property
    def channels(self) -> tuple[Channel, ...]:
        return self._channels

    @property
    def span_ns(self) -> tuple[int, int] | None:
        return self._tables.span_ns

    def __enter__(self) -> SqliteReader:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """See Container. Messages that are not CDR are left out: opening already reported them."""
        self._passes += 1
        try:
            yield from self._messages(topics, start_ns, end_ns)
        finally:
            self._passes -= 1

    def _messages(
        self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[RawMessage]:
        wanted = {
            number: channel
            for number, channel in self._tables.channel_of.items()
            if channel.message_encoding == "cdr" and (topics is None or channel.topic in topics)
        }
        tally: Counter[Channel] = Counter()
        damaged: Counter[Channel] = Counter()
        clock = _Clock()
        for number, row_id in self._keys(sorted(wanted), start_ns, end_ns):
            channel = wanted[number]
            row = self._row(row_id)
            if row is None:
                damaged[channel] += 1
                continue
            clock.see(row[0], row_id)
            tally[channel] += 1
            yield RawMessage(channel, row[0], row[1])
        for channel, count in damaged.items():
            self._report(Loss("damaged", f"{several(count, 'row')} cannot be read", channel.topic, count))
        if clock.jump_ns and (jump := clock.warning()) not in self.warnings:
            self.warnings.append(jump)
        if damaged and not tally and topics is None and start_ns is None and end_ns is None:
            raise NothingReadable(self.path, f"none of {several(damaged.total(), 'row')} can be read")
        if start_ns is None and end_ns is None:
            self._compare_counts(set(wanted.values()), tally + damaged)

    def release(self) -> None:
        """See Container."""
        if self._passes == 0:
            self._database.release()

    @property
    def _connection(self) -> sqlite3.Connection:
        return self._database.connection

    def is_divisible(self) -> bool:
        """See Container: rows whose order differs from that of their times show it over more than one window."""
        back = "SELECT rowid < lag(rowid) OVER (ORDER BY timestamp, rowid) AS back FROM messages"
        try:
            query = f"SELECT 1 FROM ({back}) WHERE back LIMIT 1"  # noqa: S608
            return not self._is_copy and self._connection.execute(query).fetchone() is None
        except (sqlite3.Error, OverflowError):
            return False

    def _keys(self, numbers: list[int], start_ns: int | None, end_ns: int | None) -> Iterator[tuple[int, int]]:
        """Topic and row id of each message in order of log time; in file order behind a damage of the time index."""
        chosen = json.dumps(numbers), 0 if start_ns is None else start_ns, MAX_TIME_NS if end_ns is None else end_ns - 1
        among = "topic_id IN (SELECT value FROM json_each(?)) AND timestamp BETWEEN ? AND ?"
        last = (-1, -1)
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

    def _row(self, row_id: int) -> tuple[int, bytes] | None:
        try:
            row = self._connection.execute("SELECT timestamp, data FROM messages WHERE rowid = ?", (row_id,)).fetchone()
        except (sqlite3.Error, OverflowError, MemoryError):
            return None
        if row is None or not isinstance(row[0], int) or not isinstance(row[1], bytes):
            return None
        return row

    def _refuse_foreign_encodings(self) -> None:
        """Names every topic that is not CDR. Raises NothingReadable when that leaves no message."""
        foreign = [channel for channel in self._channels if channel.message_encoding != "cdr" and channel.count != 0]
        for channel in foreign:
            detail = f"its messages are serialised as {channel.message_encoding!r}, which quadlog does not read (cdr)"
            self._report(Loss("serialization", detail, channel.topic, channel.count))
        if foreign and len(foreign) == sum(channel.count != 0 for channel in self._channels):
            raise NothingReadable(self.path, f"{foreign[0].topic}: {self.losses[-1].detail}")

    def _compare_counts(self, wanted: set[Channel], had: Counter[Channel]) -> None:
        for channel in self._channels:
            if channel in wanted and channel.count is not None and channel.count > had[channel]:
                missing = channel.count - had[channel]
                detail = f"{channel.count} rows, of which {missing} have no usable time or could not be reached"
                self._report(Loss("count", detail, channel.topic, missing))

    def _report(self, loss: Loss) -> None:
        if loss not in self.losses:
            self.losses.append(loss)


class _Clock:
    """Finds rows written after rows that are more than a second later in time, while rows come in order of time."""

    def __init__(self) -> None:
        self.jump_ns = 0
        self._recent: deque[tuple[int, int]] = deque()
        # Of all rows more than a second older than the current one, the last written.
        self._last_written = (-1, 0)

    def see(self, t_ns: int, row_id: int) -> None:
        self._recent.append((t_ns, row_id))
        while self._recent[0][0] < t_ns - _SECOND_NS:
            old_ns, old_id = self._recent.popleft()
            if old_id > self._last_written[0]:
                self._last_written = (old_id, old_ns)
        if self._last_written[0] > row_id:
            self.jump_ns = max(self.jump_ns, t_ns - self._last_written[1])

    def warning(self) -> str:
        return (
            f"log time goes back in the file, by {self.jump_ns / 1e9:.3f} s or more; messages come in order of log time"
        )
