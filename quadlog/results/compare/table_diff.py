"""Comparison of two tables row by row: matching rows, and the differences of each column."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from quadlog.errors import TooLarge
from quadlog.messages import Float, Int
from quadlog.results.compare.differences import (
    ColumnDifference,
    OnlyRows,
    ResultDifference,
    RowLocation,
    Tolerance,
    unequal,
)

Columns = dict[str, NDArray[Any]]

MAX_ROWS_AT_ONCE = 20_000_000
"""Limit for matching rows by their keys, which takes several times the memory of the tables."""


@dataclass(frozen=True, slots=True)
class RowMatch:
    """Row a[k] of one table matches row b[k] of the other, in the order of a; only_a, only_b: the other rows."""

    a: Int
    b: Int
    only_a: Int
    only_b: Int


def match_rows(name: str, a: Columns, b: Columns) -> RowMatch:
    """Match rows of the result `name` by key columns, (N,) each of a and (M,) each of b, in any order.

    Rows of the same key are matched in their order. Raises TooLarge.
    """
    count_a, count_b = (len(next(iter(keys.values()))) for keys in (a, b))
    if all(np.array_equal(a[key], b[key]) for key in a):
        same, nothing = np.arange(count_a), np.empty(0, np.int64)
        return RowMatch(same, same, nothing, nothing)
    if (rows := max(count_a, count_b)) > MAX_ROWS_AT_ONCE:
        raise TooLarge(f"{name}: rows to compare at once", rows, MAX_ROWS_AT_ONCE)
    import pandas as pd  # half a second, for runs whose rows differ

    one, other = pd.DataFrame(a), pd.DataFrame(b)
    for frame in (one, other):
        frame["occurrence"] = frame.groupby(list(a)).cumcount()
        frame["row"] = np.arange(len(frame))
    merged = one.merge(other, on=[*a, "occurrence"], suffixes=("_a", "_b"))
    in_a, in_b = merged["row_a"].to_numpy(), merged["row_b"].to_numpy()
    order = np.argsort(in_a)
    return RowMatch(
        in_a[order], in_b[order], np.setdiff1d(np.arange(count_a), in_a), np.setdiff1d(np.arange(count_b), in_b)
    )


def compare_tables(
    name: str, a: Columns, b: Columns, keys: Sequence[str], columns: Sequence[str], tolerance: Tolerance
) -> ResultDifference:
    """Compare the columns of rows that have the same key columns; t_ns, where it is one of them, orders in time.

    Raises TooLarge.
    """
    keys_a, keys_b = ({key: table[key] for key in keys} for table in (a, b))
    match = match_rows(name, keys_a, keys_b)
    matched = {key: values[match.a] for key, values in keys_a.items()}
    differences = []
    for column in columns:
        value_a, value_b = a[column][match.a], b[column][match.b]
        differ, apart = unequal(value_a, value_b, tolerance, angle=column.endswith("_rad"))
        differences.append(column_difference(column, matched, differ, apart, value_a, value_b))
    starts = [int(table["t_ns"].min()) for table in (keys_a, keys_b) if len(table.get("t_ns", ()))]
    return ResultDifference(
        name,
        rows_a=len(a[keys[0]]),
        rows_b=len(b[keys[0]]),
        start_ns=min(starts, default=None),
        only_in_a=_only(keys_a, match.only_a),
        only_in_b=_only(keys_b, match.only_b),
        columns=tuple(each for each in differences if each is not None),
    )


def column_difference(
    column: str, keys: Columns, differ: NDArray[np.bool_], apart: Float | None, a: NDArray[Any], b: NDArray[Any]
) -> ColumnDifference | None:
    """What differs in a column, None where nothing does.

    keys: the rows' key columns (N,); differ (N,): in which rows; apart (N,), None for text and truth values: by how
    much; a, b: the values (N,) in both.
    """
    rows = np.flatnonzero(differ)
    if not len(rows):
        return None
    row = _first(keys, rows)
    first = largest = None
    if apart is not None:
        known = apart[rows][np.isfinite(apart[rows])]
        first = float(apart[row]) if np.isfinite(apart[row]) else None
        largest = float(known.max()) if len(known) else None
    return ColumnDifference(column, len(rows), _location(keys, row), _plain(a[row]), _plain(b[row]), first, largest)


def _only(keys: Columns, rows: Int) -> OnlyRows | None:
    return OnlyRows(len(rows), _location(keys, _first(keys, rows))) if len(rows) else None


def _first(keys: Columns, rows: Int) -> int:
    """The first of these rows in time, which need not be the first in the file."""
    return int(rows[np.argmin(keys["t_ns"][rows])]) if "t_ns" in keys else int(rows[0])


def _location(keys: Columns, row: int) -> RowLocation:
    t_ns = int(keys["t_ns"][row]) if "t_ns" in keys else None
    return RowLocation(t_ns, tuple((key, _plain(values[row])) for key, values in keys.items() if key != "t_ns"))


def _plain(value: Any) -> Any:
    """A scalar of numpy as Python's; a number that does not exist is None."""
    plain = value.item() if hasattr(value, "item") else value
    return None if plain != plain else plain
