"""Differences between two runs, from single values up to whole runs, and the comparison of values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float

RunLetter = Literal["A", "B"]


@dataclass(frozen=True, slots=True)
class ValueDifference:
    """A named value; None where a run does not have it. apart: of numbers, else None."""

    key: str
    a: Any
    b: Any
    apart: float | None = None


@dataclass(frozen=True, slots=True)
class RowLocation:
    """A row of a result: its time stamp, None if rows have none, and its other key columns."""

    t_ns: int | None
    keys: tuple[tuple[str, Any], ...] = ()


@dataclass(frozen=True, slots=True)
class ColumnDifference:
    """A column: number of rows that differ, the first of them in time with both values, the largest difference.

    apart and largest are None for text and truth values, and where no differing row has a number in both runs.
    """

    column: str
    rows: int
    first: RowLocation
    a: Any
    b: Any
    apart: float | None
    largest: float | None


@dataclass(frozen=True, slots=True)
class OnlyRows:
    """Rows that only one run has: their number, and the first of them in time."""

    rows: int
    first: RowLocation


@dataclass(frozen=True, slots=True)
class ResultDifference:
    """One saved result, a table mostly, in two runs.

    only_in: the run that has it if the other does not. rows_a and rows_b: numbers of rows, if it has rows. start_ns:
    the first time stamp in either.
    """

    name: str
    only_in: RunLetter | None = None
    rows_a: int | None = None
    rows_b: int | None = None
    start_ns: int | None = None
    values: tuple[ValueDifference, ...] = ()
    only_in_a: OnlyRows | None = None
    only_in_b: OnlyRows | None = None
    columns: tuple[ColumnDifference, ...] = ()

    @property
    def lone_rows(self) -> list[tuple[RunLetter, OnlyRows]]:
        """Rows that only one run has, with the letter of that run."""
        both: tuple[tuple[RunLetter, OnlyRows | None], ...] = (("A", self.only_in_a), ("B", self.only_in_b))
        return [(letter, only) for letter, only in both if only is not None]

    @property
    def same(self) -> bool:
        """Whether there is no difference."""
        return not (self.only_in or self.values or self.only_in_a or self.only_in_b or self.columns)


@dataclass(frozen=True, slots=True)
class FirstDifference:
    """The first difference of two runs: the first stage that differs, then the earliest instant, then the first column.

    column: None if a whole result or row is in only one run, named by only_in.
    """

    stage: str
    result: str
    place: RowLocation | None = None
    column: str | None = None
    a: Any = None
    b: Any = None
    apart: float | None = None
    only_in: RunLetter | None = None


@dataclass(frozen=True, slots=True)
class RunDifference:
    """Two runs. origins: differences in how they were made, by kind (config, input, ...).

    stages: the results that at least one run has, equal ones included, by stage. start_ns: the first time stamp.
    """

    a: str
    b: str
    origins: dict[str, tuple[ValueDifference, ...]]
    stages: dict[str, tuple[ResultDifference, ...]]
    start_ns: int

    @property
    def same(self) -> bool:
        """Whether all results are the same, however the runs were made."""
        return all(result.same for results in self.stages.values() for result in results)


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Numbers no further apart than `absolute`, or `relative` times the larger magnitude, are the same."""

    absolute: float = 0.0
    relative: float = 0.0

    def allows(self, apart: Float, a: Float, b: Float) -> NDArray[np.bool_]:
        """Whether numbers (N,) a and b that are `apart` (N,) are the same; never where one of them does not exist."""
        with np.errstate(invalid="ignore"):
            allowed = np.maximum(self.absolute, self.relative * np.maximum(np.abs(a), np.abs(b)))
            return np.isfinite(apart) & (apart <= allowed)


def unequal(
    a: NDArray[Any], b: NDArray[Any], tolerance: Tolerance, angle: bool = False
) -> tuple[NDArray[np.bool_], Float | None]:
    """Where a (N,) and b (N,) differ, and how far they are apart (N,), None for text and truth values.

    NaN equals NaN. Angles [rad] are apart by the shorter way around, so that pi and -pi are neighbours.
    """
    if a.dtype.kind not in "iuf":
        return np.asarray(a != b, np.bool_), None
    differ = a != b
    if a.dtype.kind == "f":
        differ &= ~(np.isnan(a) & np.isnan(b))
    apart = _apart(a, b)
    if angle:
        with np.errstate(invalid="ignore"):
            apart = np.abs(apart - math.tau * np.round(apart / math.tau))
    return differ & ~tolerance.allows(apart, a.astype(np.float64), b.astype(np.float64)), apart


def _apart(a: NDArray[Any], b: NDArray[Any]) -> Float:
    if a.dtype.kind == "f":
        with np.errstate(invalid="ignore", over="ignore"):
            return np.abs(a - b, dtype=np.float64)
    # Larger minus smaller as unsigned numbers: right even if the difference overflows int64.
    larger, smaller = np.maximum(a, b), np.minimum(a, b)
    return (larger.astype(np.int64) - smaller.astype(np.int64)).view(np.uint64).astype(np.float64)


EXACT = Tolerance()


def flatten(content: Any) -> dict[str, Any]:
    """The leaves of a JSON object by dotted name, as in `uwb.anchors.0.x_m`; an empty table or list is a leaf itself.

    What is no object or list has no leaves.
    """
    leaves: dict[str, Any] = {}
    pending: list[tuple[str, Any]] = [("", content)]
    while pending:
        name, value = pending.pop()
        inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        if name and not (inner and value):
            leaves[name] = value
            continue
        pending += [(f"{name}.{key}" if name else str(key), each) for key, each in inner]
    return leaves


def compare_values(
    a: Mapping[str, Any], b: Mapping[str, Any], tolerance: Tolerance = EXACT
) -> tuple[ValueDifference, ...]:
    """The names whose values differ, in alphabetical order, those that only one of both has included."""
    compared = (_compare(key, a, b, tolerance) for key in sorted({*a, *b}))
    return tuple(each for each in compared if each is not None)


def _compare(key: str, a: Mapping[str, Any], b: Mapping[str, Any], tolerance: Tolerance) -> ValueDifference | None:
    one, other = a.get(key), b.get(key)
    if not (_is_number(one) and _is_number(other)):
        same = key in a and key in b and type(one) is type(other) and one == other
        return None if same else ValueDifference(key, one, other)
    differ, apart = unequal(np.array([one], np.float64), np.array([other], np.float64), tolerance)
    if not differ[0] or apart is None:
        return None
    return ValueDifference(key, one, other, float(apart[0]) if np.isfinite(apart[0]) else None)


def _is_number(value: Any) -> bool:
    """Whether it is a number that fits 64 bits; JSON allows longer integers."""
    return isinstance(value, float) or (isinstance(value, int) and type(value) is not bool and abs(value) < 1 << 63)
