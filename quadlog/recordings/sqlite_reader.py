"""ROS 2 bags in SQLite (`.db3`). The format has no checksums: only what breaks a page or a row can be seen."""

from __future__ import annotations

import json
import sqlite3
from array import array
from collections import Counter
from collections.abc import Collection, Iterator
from copy import copy
from pathlib import Path
from types import TracebackType

import numpy as np

from quadlog.errors import NothingReadable
from quadlog.messages import Int
from quadlog.recordings.bounded import MAX_TIME_NS, Damaged
from quadlog.recordings.container import Budget, Channel, LogTimes, Loss, RawMessage, places_within, spread
from quadlog.recordings.sqlite_open import OpenDatabase, open_database
from quadlog.recordings.sqlite_tables import Tables, read_tables
from quadlog.recordings.words import several

_SECOND_NS = 10**9
_BATCH_ROWS = 1 << 14


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
        # Of an excerpt: row ids at which its places begin, and the rows of each.
        self._places: list[int] | None = None
        self._rows_of_place = 0
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
        if self._places is None:
            self.warnings += [each for each in clock.warnings() if each not in self.warnings]
        if damaged and not tally and topics is None and start_ns is None and end_ns is None:
            raise NothingReadable(self.path, f"none of {several(damaged.total(), 'row')} can be read")
        if start_ns is None and end_ns is None and self._places is None:
            self._compare_counts(set(wanted.values()), tally + damaged)

    def log_times(self) -> Iterator[LogTimes]:
        """See Container. A walk over the table: payloads that do not fit beside their row are not touched."""
        if self.losses:
            raise Damaged(self.losses[0].detail)
        return self._listed_times()

    def _listed_times(self) -> Iterator[LogTimes]:
        query = (
            "SELECT topic_id, timestamp, rowid FROM messages "  # noqa: S608
            f"WHERE timestamp BETWEEN 0 AND {MAX_TIME_NS} ORDER BY timestamp, rowid"
        )
        tally: Counter[Channel] = Counter()
        clock = _Clock()
        try:
            cursor = self._connection.execute(query)
            while rows := cursor.fetchmany(_BATCH_ROWS):
                numbers, t_ns, row_ids = np.array(rows, np.int64).T
                clock.see_all(t_ns, row_ids)
                for number in np.unique(numbers).tolist():
                    channel = self._tables.channel_of[number]
                    times = LogTimes(int(t_ns[0]), channel, t_ns[numbers == number])
                    tally[channel] += len(times.t_ns)
                    yield times
        except (sqlite3.Error, OverflowError, ValueError, TypeError, KeyError) as error:
            raise Damaged(f"the rows cannot be listed ({error})") from None
        if any((channel.count or 0) != tally[channel] for channel in self._channels):
            raise Damaged("not every row has a usable time")
        self.warnings += [each for each in clock.warnings() if each not in self.warnings]

    def excerpt(self, budget: Budget) -> SqliteReader | None:
        """See Container. A place is some rows that were written one after the other."""
        messages = sum(channel.count or 0 for channel in self._channels)
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
        try:
            # Each on its own: of both at once SQLite would walk the table.
            (first,) = self._connection.execute("SELECT MIN(rowid) FROM messages").fetchone()
            (last,) = self._connection.execute("SELECT MAX(rowid) FROM messages").fetchone()
            (pages,) = self._connection.execute("PRAGMA page_count").fetchone()
            (page_bytes,) = self._connection.execute("PRAGMA page_size").fetchone()
        except sqlite3.Error:
            return 0, 0, 0
        return first or 0, last or 0, pages * page_bytes

    def release(self) -> None:
        """See Container."""
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
        """The same of an excerpt."""
        place = "SELECT topic_id, rowid, timestamp FROM messages WHERE rowid >= ? ORDER BY rowid LIMIT ?"
        query = f"SELECT timestamp, rowid, topic_id FROM ({place}) WHERE {among}"  # noqa: S608
        keys: set[tuple[int, int, int]] = set()
        try:
            for first in self._places or ():
                keys.update(self._connection.execute(query, (first, self._rows_of_place, *chosen)))
        except (sqlite3.Error, OverflowError) as error:
            self._report(Loss("damaged", f"rows cannot be reached ({error})"))
        return [(number, row_id) for _, row_id, number in sorted(keys)]

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
        # Rows of the last second that were compared, and new ones behind them.
        self._t_ns, self._row_ids = array("q"), array("q")
        self._compared = 0
        # Of all rows before these, the one written last, and its time.
        self._last_id, self._last_ns = -1, 0

    def see(self, t_ns: int, row_id: int) -> None:
        """One row."""
        self._t_ns.append(t_ns)
        self._row_ids.append(row_id)
        if len(self._t_ns) - self._compared >= _BATCH_ROWS:
            self.compare()

    def see_all(self, t_ns: Int, row_ids: Int) -> None:
        """Rows (N,)."""
        self._t_ns.extend(t_ns.tolist())
        self._row_ids.extend(row_ids.tolist())
        self.compare()

    def compare(self) -> None:
        """Hold new rows against all that are more than a second older."""
        t_ns, row_ids = np.array(self._t_ns, np.int64), np.array(self._row_ids, np.int64)
        if len(t_ns) == 0:
            return
        highest = np.maximum.accumulate(np.concatenate([[self._last_id], row_ids]))
        highest_row = np.maximum.accumulate(np.where(np.diff(highest) > 0, np.arange(len(t_ns)), -1))
        highest_ns = np.concatenate([[self._last_ns], np.where(highest_row < 0, self._last_ns, t_ns[highest_row])])
        older = np.searchsorted(t_ns, t_ns[self._compared :] - _SECOND_NS)
        back_ns = np.where(highest[older] > row_ids[self._compared :], t_ns[self._compared :] - highest_ns[older], 0)
        self.jump_ns = max(self.jump_ns, int(back_ns.max(initial=0)))
        dropped = int(np.searchsorted(t_ns, t_ns[-1] - _SECOND_NS))
        self._last_id, self._last_ns = int(highest[dropped]), int(highest_ns[dropped])
        self._t_ns, self._row_ids = self._t_ns[dropped:], self._row_ids[dropped:]
        self._compared = len(self._t_ns)

    def warnings(self) -> list[str]:
        """No warning or one."""
        self.compare()
        if not self.jump_ns:
            return []
        back_s = self.jump_ns / 1e9
        return [f"log time goes back in the file, by {back_s:.3f} s or more; messages come in order of log time"]
