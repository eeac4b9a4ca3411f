"""Two tables compared row by row: which rows match, which column differs where first, in how many rows, and by how
much at most.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from quadlog.errors import NotARun, TooLarge
from quadlog.messages import Int
from quadlog.results.compare.differences import (
    ColumnDifference,
    OnlyRows,
    ResultDifference,
    RowLocation,
    Tolerance,
    unequal,
)
from quadlog.results.run.tables import TABLES, column_to_numpy


@dataclass(frozen=True, slots=True)
class RowMatch:
    """Row a[k] of the one is row b[k] of the other, in the one's order; the rest is in one of them only."""

    a: Int
    b: Int
    only_a: Int
    only_b: Int


def match_rows(a: Sequence[NDArray[Any]], b: Sequence[NDArray[Any]]) -> RowMatch:
    """Match rows by key columns, (N,) each of a and (M,) each of b, in whatever order the rows are.

    Of rows with the same key the first of the one belongs to the first of the other, and so on.
    """
    n = len(a[0])
    code = np.zeros(n + len(b[0]), np.int64)
    for one, other in zip(a, b, strict=True):
        code = _joint(code, np.unique(np.concatenate([one, other]), return_inverse=True)[1])
    code = _joint(code, np.concatenate([_occurrence(code[:n]), _occurrence(code[n:])]))
    _, in_a, in_b = np.intersect1d(code[:n], code[n:], assume_unique=True, return_indices=True)
    order = np.argsort(in_a, kind="stable")
    return RowMatch(
        in_a[order], in_b[order], np.setdiff1d(np.arange(n), in_a), np.setdiff1d(np.arange(len(code) - n), in_b)
    )


def _joint(code: Int, further: Int) -> Int:
    """One number for each pair of numbers, none above how many there are, so that no product overflows."""
    if not len(code):
        return code
    return np.unique(code * (int(further.max()) + 1) + further, return_inverse=True)[1]


def _occurrence(code: Int) -> Int:
    """How many equal codes stand before each."""
    order = np.argsort(code, kind="stable")
    ordered = code[order]
    starts = np.flatnonzero(np.diff(ordered, prepend=-1))
    place = np.arange(len(code)) - np.repeat(starts, np.diff(np.append(starts, len(code))))
    occurrence = np.empty_like(code)
    occurrence[order] = place
    return occurrence


MAX_ROWS_AT_ONCE = 20_000_000


class RowGroups(Protocol):
    """Columns of equal length, cut into groups of rows."""

    @property
    def rows(self) -> int:
        """All of them."""
        ...

    @property
    def groups(self) -> int:
        """How many groups there are."""
        ...

    def read(self, columns: Sequence[str], first: int, last: int) -> dict[str, NDArray[Any]]:
        """The columns of the groups first to last - 1, (N,) each."""
        ...


class ArrayRows:
    """Columns that are in memory anyway, (N,) each: one group."""

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        self._columns = columns
        self.rows = len(next(iter(columns.values())))
        self.groups = 1

    def read(self, columns: Sequence[str], first: int, last: int) -> dict[str, NDArray[Any]]:
        """The columns whole: that group is all there is."""
        return {name: self._columns[name] for name in columns}


class ParquetRows:
    """A table of a run folder, read by its row groups."""

    def __init__(self, path: Path, parquet: pq.ParquetFile) -> None:
        self._path, self._parquet = path, parquet
        self.rows: int = parquet.metadata.num_rows
        self.groups: int = parquet.num_row_groups

    def read(self, columns: Sequence[str], first: int, last: int) -> dict[str, NDArray[Any]]:
        """int64, float64 (NaN where there is no value), bool or str objects. Raises NotARun, TooLarge."""
        wanted = range(first, last)
        rows = sum(self._parquet.metadata.row_group(i).num_rows for i in wanted)
        if rows > MAX_ROWS_AT_ONCE:
            raise TooLarge(f"{self._path}: rows to compare at once", rows, MAX_ROWS_AT_ONCE)
        with _damage_named(self._path):
            table = self._parquet.read_row_groups(list(wanted), columns=list(columns), use_threads=False)
        return {name: column_to_numpy(self._path, name, table.column(name)) for name in columns}


@contextmanager
def open_table(run: Path, name: str) -> Iterator[ParquetRows]:
    """The table `name` of a run folder, with the columns of the contract. Raises NotARun for any other file."""
    path, schema = run / f"{name}.parquet", TABLES[name]
    with _damage_named(path):
        parquet = pq.ParquetFile(path, page_checksum_verification=True)
    with parquet:
        with _damage_named(path):
            found = parquet.schema_arrow
        for field in schema:
            if field.name not in found.names or found.field(field.name).type != field.type:
                raise NotARun(path, f"has no column {field.name} of type {field.type}")
        yield ParquetRows(path, parquet)


@contextmanager
def _damage_named(path: Path) -> Iterator[None]:
    try:
        yield
    except (pa.ArrowException, OSError, ValueError, KeyError, NotImplementedError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise NotARun(path, f"is damaged or no table: {reason}") from error


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
        self._first: tuple[RowLocation, Any, Any, float | None] | None = None
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

    def add_found(
        self, rows: int, place: RowLocation, a: Any, b: Any, apart: float | None, largest: float | None
    ) -> None:
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


def place_of(keys: Columns, row: int) -> RowLocation:
    """Where a row is, by its key columns."""
    t_ns = int(keys["t_ns"][row]) if "t_ns" in keys else None
    return RowLocation(t_ns, tuple((key, _plain(values[row])) for key, values in keys.items() if key != "t_ns"))


def _first_and_largest(apart: NDArray[Any] | None, row: int, rows: Int) -> tuple[float | None, float | None]:
    if apart is None:
        return None, None
    known = apart[rows][np.isfinite(apart[rows])]
    first = float(apart[row]) if np.isfinite(apart[row]) else None
    return first, float(known.max()) if len(known) else None


def _equal_keys(a: Columns, b: Columns) -> bool:
    return all(np.array_equal(a[key], b[key]) for key in a)


def _earlier(one: RowLocation, other: RowLocation) -> bool:
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
