"""Two tables compared row by row: which column differs where first, in how many rows, and by how much at most."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Int
from quadlog.results.differences import ColumnDifference, OnlyRows, Place, ResultDifference
from quadlog.results.equality import Tolerance, unequal
from quadlog.results.row_match import match_rows
from quadlog.results.table_groups import RowGroups

Columns = dict[str, NDArray[Any]]


def compare_tables(
    name: str, a: RowGroups, b: RowGroups, keys: Sequence[str], columns: Sequence[str], tolerance: Tolerance
) -> ResultDifference:
    """Compare the columns of rows that have the same key columns; t_ns, where it is one of them, orders in time.

    Groups are walked side by side as long as their keys are equal. From the
    first that are not, what is left is matched by its keys, a column at a time.

    Raises what a group's reading raises.
    """
    found = {column: ColumnFinding(column) for column in columns}
    starts: list[int] = []
    group = 0
    while group < min(a.groups, b.groups):
        keys_a, keys_b = a.read(keys, group, group + 1), b.read(keys, group, group + 1)
        if not _equal_keys(keys_a, keys_b):
            break
        rows_a, rows_b = a.read(columns, group, group + 1), b.read(columns, group, group + 1)
        for column in columns:
            found[column].add(rows_a[column], rows_b[column], keys_a, tolerance)
        starts += _start(keys_a)
        group += 1
    only_a = only_b = None
    if group < max(a.groups, b.groups):
        keys_a, keys_b = a.read(keys, group, a.groups), b.read(keys, group, b.groups)
        match = match_rows(list(keys_a.values()), list(keys_b.values()))
        matched = {key: values[match.a] for key, values in keys_a.items()}
        for column in columns:
            value_a, value_b = a.read([column], group, a.groups)[column], b.read([column], group, b.groups)[column]
            found[column].add(value_a[match.a], value_b[match.b], matched, tolerance)
        only_a, only_b = _only(keys_a, match.only_a), _only(keys_b, match.only_b)
        starts += _start(keys_a) + _start(keys_b)
    return ResultDifference(
        name,
        rows_a=a.rows,
        rows_b=b.rows,
        start_ns=min(starts, default=None),
        only_in_a=only_a,
        only_in_b=only_b,
        columns=tuple(each for column in columns if (each := found[column].difference()) is not None),
    )


class ColumnFinding:
    """What differs in one column, gathered piece by piece."""

    def __init__(self, column: str) -> None:
        self.column = column
        self._rows = 0
        self._first: tuple[Place, Any, Any, float | None] | None = None
        self._largest: float | None = None

    def add(self, a: NDArray[Any], b: NDArray[Any], keys: Columns, tolerance: Tolerance) -> None:
        """Further rows: the values (N,) in both, and the rows' key columns (N,)."""
        differ, apart = unequal(a, b, tolerance, angle=self.column.endswith("_rad"))
        rows = np.flatnonzero(differ)
        if not len(rows):
            return
        # Tables may be in order of tag first: the first in time is not the first in the file.
        row = int(rows[np.argmin(keys["t_ns"][rows])]) if "t_ns" in keys else int(rows[0])
        self.add_found(len(rows), place_of(keys, row), a[row], b[row], *_first_and_largest(apart, row, rows))

    def add_found(self, rows: int, place: Place, a: Any, b: Any, apart: float | None, largest: float | None) -> None:
        """Further rows that differ, of which the first has these values."""
        self._rows += rows
        if largest is not None:
            self._largest = max(largest, self._largest or 0.0)
        if self._first is None or _earlier(place, self._first[0]):
            self._first = place, _plain(a), _plain(b), apart

    def difference(self) -> ColumnDifference | None:
        """All of it, None where nothing differed."""
        if self._first is None:
            return None
        place, a, b, apart = self._first
        return ColumnDifference(self.column, self._rows, place, a, b, apart, self._largest)


def place_of(keys: Columns, row: int) -> Place:
    """Where a row is, by its key columns."""
    t_ns = int(keys["t_ns"][row]) if "t_ns" in keys else None
    return Place(t_ns, tuple((key, _plain(values[row])) for key, values in keys.items() if key != "t_ns"))


def _first_and_largest(apart: NDArray[Any] | None, row: int, rows: Int) -> tuple[float | None, float | None]:
    if apart is None:
        return None, None
    known = apart[rows][np.isfinite(apart[rows])]
    first = float(apart[row]) if np.isfinite(apart[row]) else None
    return first, float(known.max()) if len(known) else None


def _equal_keys(a: Columns, b: Columns) -> bool:
    return all(np.array_equal(a[key], b[key]) for key in a)


def _earlier(one: Place, other: Place) -> bool:
    return one.t_ns is not None and other.t_ns is not None and one.t_ns < other.t_ns


def _only(keys: Columns, rows: Int) -> OnlyRows | None:
    if not len(rows):
        return None
    row = int(rows[np.argmin(keys["t_ns"][rows])]) if "t_ns" in keys else int(rows[0])
    return OnlyRows(len(rows), place_of(keys, row))


def _start(keys: Columns) -> list[int]:
    return [int(keys["t_ns"].min())] if len(keys.get("t_ns", ())) else []


def _plain(value: Any) -> Any:
    """A scalar of numpy as Python's; a number that does not exist is None."""
    plain = value.item() if hasattr(value, "item") else value
    return None if plain != plain else plain
