"""What a table of a paper holds beside ours: rows in groups, pictures, and what was run to get them."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PaperRow:
    """One quantity, its unit in its name: what the paper prints, and what quadlog finds.

    paper: None where the paper prints none.
    low, high: 95 % interval of ours; None where ours is computed without any random draw.
    reproduces: None where there is nothing to reproduce; note: one sentence why not, or what ours rests on.
    """

    quantity: str
    ours: float
    paper: float | None = None
    low: float | None = None
    high: float | None = None
    reproduces: bool | None = None
    note: str = ""

    def __post_init__(self) -> None:
        given = (self.ours, self.paper, self.low, self.high)
        assert all(math.isfinite(value) for value in given if value is not None), self
        assert (self.low is None) == (self.high is None), self

    @property
    def difference(self) -> float | None:
        """Ours less the paper's."""
        return None if self.paper is None else self.ours - self.paper


@dataclass(frozen=True, slots=True)
class RowGroup:
    """Rows that belong together under one title; text says how they were measured."""

    title: str
    text: str
    rows: tuple[PaperRow, ...]


@dataclass(frozen=True, slots=True)
class Picture:
    """A PNG of a table. name: a file's stem; alt: for who cannot see it; caption: how to read it."""

    name: str
    alt: str
    caption: str
    png: bytes


@dataclass(frozen=True, slots=True)
class PaperTable:
    """A table or a few figures of a paper, measured again.

    name: as the command line takes it. sizes: one sentence on how many seeds, fixes or episodes it rests on.
    errata: sentences on what is wrong in print and concerns this table.
    """

    name: str
    title: str
    caption: str
    sizes: str
    seed: int
    fast: bool
    groups: tuple[RowGroup, ...]
    pictures: tuple[Picture, ...] = ()
    errata: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        quantities = [row.quantity for row in self.rows]
        assert len(set(quantities)) == len(quantities), "a quantity names its row in the CSV file"

    @property
    def rows(self) -> tuple[PaperRow, ...]:
        """The rows of all groups, in order."""
        return tuple(row for group in self.groups for row in group.rows)

    @property
    def judged(self) -> tuple[PaperRow, ...]:
        """The rows that reproduce or do not."""
        return tuple(row for row in self.rows if row.reproduces is not None)

    @property
    def reproduced(self) -> str:
        """How many of what the paper prints, in words."""
        if not self.judged:
            return "the paper prints none"
        return f"{sum(row.reproduces is True for row in self.judged)} of {len(self.judged)} printed numbers reproduce"

    @property
    def command(self) -> str:
        """The command line that makes this table."""
        fast, seed = " --fast" if self.fast else "", f" --seed {self.seed}" if self.seed else ""
        return f"quadlog tables {self.name}{fast}{seed}"
