"""Tables as data: seeded walks that are measured, and rows that compare their figures with what a paper prints."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from quadlog.messages import Float
from quadlog.pipelines.tables.judge import GEOMETRIC_MEAN, MEAN, NEGLIGIBLE, SHARE, Judge, Statistic, beyond
from quadlog.results.studies.papers import PaperRow, PaperTable, RowGroup, Verdict

Point = dict[str, Any]
Figures = Mapping[str, float]

HELD_OUT_SEED = 2000
"""Seeds that are reported start here; whatever was chosen, was chosen on smaller ones."""
SEEDS_PER_TABLE = 100


def held_out_seeds(count: int, seed: int) -> range:
    """The walks' seeds of a table's seed; those of two tables' seeds have none in common."""
    assert count <= SEEDS_PER_TABLE
    first = HELD_OUT_SEED + SEEDS_PER_TABLE * seed
    return range(first, first + count)


def grid(**factors: Iterable[Any]) -> list[Point]:
    """Every combination of the factors' values."""
    return [dict(zip(factors, values, strict=True)) for values in product(*factors.values())]


@dataclass(frozen=True)
class Study:
    """measure(**point) walks once and returns its figures by name; one that does not apply is absent."""

    measure: Callable[..., Figures]
    points: Sequence[Point]

    def submit(self, executor: Executor) -> list[Future[Figures]]:
        """A task for each point."""
        return [executor.submit(self.measure, **point) for point in self.points]

    def records(self, figures: Iterable[Figures]) -> list[Point]:
        """Points and figures side by side, plain numbers all; a figure that is not finite is left out."""
        return [
            point | {name: float(value) for name, value in found.items() if math.isfinite(value)}
            for point, found in zip(self.points, figures, strict=True)
        ]


def select(walks: pd.DataFrame, where: Mapping[str, Any]) -> pd.DataFrame:
    """The walks whose factors have these values; None stands for a factor that is not given."""
    wanted = pd.Series(True, index=walks.index)
    for name, value in where.items():
        wanted &= walks[name].isna() if value is None else walks[name] == value
    return walks[wanted]


Where = Mapping[str, Any]


@dataclass(frozen=True)
class Claim:
    """A row: a statistic of a column. where: values of factors that select walks; judge: None if nothing is printed.

    note: shown with every verdict; why_not: shown with the verdict "no". of: as of PaperRow.
    """

    quantity: str
    column: str
    where: Where = field(default_factory=dict)
    judge: Judge | None = None
    statistic: Statistic = MEAN
    note: str = ""
    why_not: str = ""
    of: str = ""

    def values(self, walks: pd.DataFrame) -> Float:
        """(N,) of the walks that have it."""
        mine = select(walks, self.where)
        return mine[self.column].dropna().to_numpy(float) if self.column in mine else np.empty(0)

    def row(self, walks: pd.DataFrame) -> PaperRow | None:
        """The row with our number, interval and verdict; None where no walk has it."""
        values = self.values(walks)
        if not len(values):
            return None
        interval = self.statistic.interval(values)
        low, high = interval or (None, None)
        notes = [f"{int(values.sum())} of {len(values)}." if self.statistic is SHARE else "", self.note]
        row = PaperRow(self.quantity, float(self.statistic.of(values)), None, low, high, of=self.of)
        if self.judge is None:
            return replace(row, note=" ".join(filter(None, notes)))
        verdict = self.judge.verdict(values, self.statistic)
        notes.append(self.why_not if verdict is Verdict.NO and self.why_not else self.judge.why)
        if self.statistic.is_drawn and self.judge.takes_interval and len(values) <= 2:
            verdict = Verdict.NOT_COMPARABLE
            notes.append("2 walks decide nothing." if len(values) == 2 else "1 walk decides nothing.")
        note = " ".join(filter(None, notes))
        return replace(row, paper=self.judge.printed, reproduces=verdict, note=note, claim=self.judge.said)


@dataclass(frozen=True)
class Ratio(Claim):
    """A column of the walks `part` divided by that of the walks `whole`, paired by equal values of `pair`."""

    part: Where = field(default_factory=dict)
    whole: Where = field(default_factory=dict)
    pair: Sequence[str] = ("seed",)
    statistic: Statistic = GEOMETRIC_MEAN
    compare: Callable[[Float, Float], Float] = np.divide

    def values(self, walks: pd.DataFrame) -> Float:
        """(N,) of the pairs that have both."""
        if self.column not in walks:
            return np.empty(0)
        sides = (select(walks, {**self.where, **side}) for side in (self.part, self.whole))
        columns = [side.set_index(list(self.pair))[self.column] for side in sides]
        both = pd.concat(columns, axis=1, join="inner").dropna().to_numpy(float)
        return self.compare(both[:, 0], both[:, 1])


@dataclass(frozen=True)
class Change(Ratio):
    """A column of the walks `part` less that of the walks `whole`, paired likewise."""

    statistic: Statistic = MEAN
    compare: Callable[[Float, Float], Float] = np.subtract


def order(quantity: str, column: str, where: Where, part: Where, whole: Where, printed: float, of: str) -> Ratio:
    """A row on which of two is larger, as a printed ratio above 1 says; how much larger is not judged."""
    least = 1 + NEGLIGIBLE * (printed - 1)
    return Ratio(
        quantity,
        column,
        where,
        beyond(1.0, least=least),
        note=f"The order alone; the printed ratio is {printed:.3f}.",
        why_not=f"Ours is not above {least:.4g}, a tenth of what is printed.",
        of=of,
        part=part,
        whole=whole,
    )


@dataclass(frozen=True)
class Group:
    """Rows under one title; text: how they were measured."""

    title: str
    text: str
    rows: Sequence[Claim]

    def on(self, walks: pd.DataFrame) -> RowGroup:
        """The rows with our numbers; those that no walk has are left out."""
        return RowGroup(self.title, self.text, tuple(row for each in self.rows if (row := each.row(walks)) is not None))


@dataclass(frozen=True)
class StudyTable:
    """A table of a paper: its text, the study that measures it, and its rows in groups."""

    title: str
    caption: str
    sizes: str
    study: Study
    groups: Sequence[Group]

    def on(self, walks: pd.DataFrame, name: str, fast: bool, seed: int) -> PaperTable:
        """Judge the walks of its study."""
        groups = tuple(found for group in self.groups if (found := group.on(walks)).rows)
        return PaperTable(name, self.title, self.caption, self.sizes, seed, fast, groups)
