"""Rows of a table as data: of which walks, which column, beside which print; and the tables that they make."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from quadlog.messages import Float
from quadlog.pipelines.tables.judge import GEOMETRIC_MEAN, MEAN, NEGLIGIBLE, SHARE, Judge, Statistic, beyond
from quadlog.pipelines.tables.study import Study, select
from quadlog.results.studies.papers import PaperRow, PaperTable, RowGroup, Verdict

Where = Mapping[str, Any]


@dataclass(frozen=True)
class Claim:
    """A statistic of a column. where: factors of the walks that count; judge: None where nothing is printed.

    note: what every verdict needs to be read; why_not: added where it fails. of: as of PaperRow.
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
        note = " ".join(filter(None, notes))
        return replace(row, paper=self.judge.printed, reproduces=verdict, note=note, claim=self.judge.said)


@dataclass(frozen=True)
class Ratio(Claim):
    """A column of some walks, `part`, over that of others, `whole`, in pairs that have the same values of `pair`."""

    part: Where = field(default_factory=dict)
    whole: Where = field(default_factory=dict)
    pair: Sequence[str] = ("seed",)
    statistic: Statistic = GEOMETRIC_MEAN

    def values(self, walks: pd.DataFrame) -> Float:
        """(N,) quotients."""
        part, whole = self._pairs(walks)
        return part / whole

    def _pairs(self, walks: pd.DataFrame) -> tuple[Float, Float]:
        """(N,) the column of both sides, of pairs that have both."""
        if self.column not in walks:
            return np.empty(0), np.empty(0)
        sides = (select(walks, {**self.where, **side}) for side in (self.part, self.whole))
        columns = [side.set_index(list(self.pair))[self.column] for side in sides]
        both = pd.concat(columns, axis=1, join="inner").dropna().to_numpy(float)
        return both[:, 0], both[:, 1]


@dataclass(frozen=True)
class Change(Ratio):
    """The same as differences."""

    statistic: Statistic = MEAN

    def values(self, walks: pd.DataFrame) -> Float:
        """(N,) part less whole."""
        part, whole = self._pairs(walks)
        return part - whole


def order(quantity: str, column: str, where: Where, part: Where, whole: Where, printed: float, of: str) -> Ratio:
    """A row on which of two is larger, as a printed ratio above 1 says; how much larger, is not judged."""
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
class Table:
    """A paper's table as data: where its numbers come from, and what stands beside which print."""

    title: str
    caption: str
    sizes: str
    study: Study
    groups: Sequence[Group]

    def on(self, walks: pd.DataFrame, name: str, fast: bool, seed: int) -> PaperTable:
        """Judge the walks of its study."""
        groups = tuple(found for group in self.groups if (found := group.on(walks)).rows)
        return PaperTable(name, self.title, self.caption, self.sizes, seed, fast, groups)
