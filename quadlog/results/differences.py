"""What `quadlog diff` says of two runs: plain data, from a single value up to the whole."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

RunLetter = Literal["A", "B"]


@dataclass(frozen=True, slots=True)
class ValueDifference:
    """A named value; None where a run does not have it. apart: of numbers, else None."""

    key: str
    a: Any
    b: Any
    apart: float | None = None


@dataclass(frozen=True, slots=True)
class Place:
    """Which row of a result: its instant, None where rows have none, and the other columns that tell it apart."""

    t_ns: int | None
    keys: tuple[tuple[str, Any], ...] = ()


@dataclass(frozen=True, slots=True)
class ColumnDifference:
    """A column: how many rows differ, the first of them in time with both values, and the largest difference.

    apart and largest are None for text and truth values, and where no differing row has a number in both runs.
    """

    column: str
    rows: int
    first: Place
    a: Any
    b: Any
    apart: float | None
    largest: float | None


@dataclass(frozen=True, slots=True)
class OnlyRows:
    """Rows that one run alone has: how many, and the first of them in time."""

    rows: int
    first: Place


@dataclass(frozen=True, slots=True)
class ResultDifference:
    """One saved result, a table mostly, in two runs.

    only_in: the run that alone has it. rows_a and rows_b: their lengths, where
    it has rows. start_ns: the first instant in either.
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
    def same(self) -> bool:
        """Whether nothing of it differs."""
        return not (self.only_in or self.values or self.only_in_a or self.only_in_b or self.columns)


@dataclass(frozen=True, slots=True)
class FirstDifference:
    """Where two runs part: the first stage that differs, and in it the earliest instant, then the first column.

    column: None where a whole result or a row is in one run alone, which only_in names then.
    """

    stage: str
    result: str
    place: Place | None = None
    column: str | None = None
    a: Any = None
    b: Any = None
    apart: float | None = None
    only_in: RunLetter | None = None


@dataclass(frozen=True, slots=True)
class RunDifference:
    """Two runs. origins: by what (config, input, ...) was different in how they were made.

    stages: of each stage the results that at least one run has, in order, the
    same ones too. start_ns: the first instant of all.
    """

    a: str
    b: str
    origins: dict[str, tuple[ValueDifference, ...]]
    stages: dict[str, tuple[ResultDifference, ...]]
    start_ns: int

    @property
    def same(self) -> bool:
        """Whether every result is the same; how the runs were made does not count."""
        return all(result.same for results in self.stages.values() for result in results)
