"""Rows of a saved result a group at a time, so that two long tables can be walked side by side in little memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from quadlog.errors import NotARun, TooLarge
from quadlog.results.schemas import TABLES
from quadlog.results.tables import column_to_numpy

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
