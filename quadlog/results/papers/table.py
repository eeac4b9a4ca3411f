"""A measured table of a paper: rows in groups, and how it was measured; saved and loaded."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any


class Verdict(StrEnum):
    """Whether what a paper prints reproduces.

    undecided: our interval holds both what the paper prints and its contrary. not comparable: the paper does not say
    how its number came about, ours rests on that very number, or holds by construction.
    """

    YES = "yes"
    NO = "no"
    UNDECIDED = "undecided"
    NOT_COMPARABLE = "not comparable"


@dataclass(frozen=True, slots=True)
class PaperRow:
    """One quantity, its unit in the name: the paper's number and quadlog's.

    paper: None where the paper prints none; a claim in words is judged all the same.
    ours: of all runs; low, high: 95 % interval of the same statistic over the same runs, None where nothing is drawn.
    claim: what the paper says instead of a number, as "> 5"; paper is then the 5, or None.
    reproduces: None where there is nothing to reproduce; note: one sentence why not, or what ours rests on.
    of: which number or claim of the paper this is one setting of; empty where it is the only one.
    """

    quantity: str
    ours: float
    paper: float | None = None
    low: float | None = None
    high: float | None = None
    reproduces: Verdict | None = None
    note: str = ""
    claim: str = ""
    of: str = ""

    def __post_init__(self) -> None:
        given = (self.ours, self.paper, self.low, self.high)
        assert all(math.isfinite(value) for value in given if value is not None), self
        assert (self.low is None) == (self.high is None), self
        assert self.reproduces is None or isinstance(self.reproduces, Verdict), self

    @property
    def difference(self) -> float | None:
        """Ours less the paper's."""
        return None if self.paper is None else self.ours - self.paper


@dataclass(frozen=True, slots=True)
class RowGroup:
    """Rows under one title; text: how they were measured."""

    title: str
    text: str
    rows: tuple[PaperRow, ...]


@dataclass(frozen=True, slots=True)
class PaperTable:
    """A table or a few figures of a paper, measured again.

    name: as the command line takes it. sizes: one sentence on how many seeds, fixes or episodes it rests on.
    """

    name: str
    title: str
    caption: str
    sizes: str
    seed: int
    fast: bool
    groups: tuple[RowGroup, ...]

    def __post_init__(self) -> None:
        quantities = [row.quantity for row in self.rows]
        assert len(set(quantities)) == len(quantities), "a quantity names its row in the CSV file"

    @property
    def rows(self) -> tuple[PaperRow, ...]:
        """The rows of all groups, in order."""
        return tuple(row for group in self.groups for row in group.rows)

    @property
    def claims(self) -> dict[str, Verdict]:
        """The verdict on each number and claim of the paper, once, whatever the number of settings it is measured in.

        Yes or no where some setting says so and none the contrary; undecided where settings contradict each other.
        """
        found: dict[str, set[Verdict]] = {}
        for row in self.rows:
            if row.reproduces is not None:
                found.setdefault(row.of or row.quantity, set()).add(row.reproduces)
        return {claim: _joined(verdicts) for claim, verdicts in found.items()}

    @property
    def reproduced(self) -> str:
        """How many of the claims reproduce, in words."""
        return reproduced(self.claims.values()) or "the paper prints none"

    @property
    def command(self) -> str:
        """The command line that makes this table."""
        fast, seed = " --fast" if self.fast else "", f" --seed {self.seed}" if self.seed else ""
        return f"quadlog tables {self.name}{fast}{seed}"


def _joined(verdicts: set[Verdict]) -> Verdict:
    clear = verdicts & {Verdict.YES, Verdict.NO}
    if len(clear) == 1:
        return clear.pop()
    return Verdict.NOT_COMPARABLE if verdicts == {Verdict.NOT_COMPARABLE} else Verdict.UNDECIDED


def reproduced(verdicts: Iterable[Verdict]) -> str:
    """Counts of claims in words, empty without any."""
    counts = Counter(verdicts)
    words = {Verdict.YES: "reproduce", Verdict.NO: "do not"}
    parts = [f"{counts[verdict]} {words.get(verdict, verdict)}" for verdict in Verdict if counts[verdict]]
    claims = f"{counts.total()} claim{'s' * (counts.total() != 1)}"
    return f"{claims}: {', '.join(parts)}" if parts else ""


LARGEST_BYTES = 16_000_000
"""No more is read of a file; no table comes near."""


@dataclass(frozen=True, slots=True)
class Origin:
    """What the content of a table depends on. code: digest of quadlog and its packages; fast, seed: as requested."""

    code: str
    fast: bool
    seed: int


@dataclass(frozen=True, slots=True)
class SavedTable:
    """A table in a folder, its origin, and the walks that it rests on: a row of factors and figures for each."""

    table: PaperTable
    origin: Origin
    walks: Sequence[Mapping[str, Any]] = ()


def json_bytes(saved: SavedTable) -> bytes:
    """All of it as JSON."""
    return (json.dumps(asdict(saved), indent=1, ensure_ascii=False) + "\n").encode()


def load_saved(folder: Path, name: str) -> SavedTable | None:
    """The table saved in a folder; None if it is missing, incomplete or not one."""
    try:
        with (folder / f"{name}.json").open("rb") as stream:
            body = json.loads(stream.read(LARGEST_BYTES))
        fields = body["table"]
        groups = tuple(RowGroup(**group | {"rows": tuple(map(_row, group["rows"]))}) for group in fields["groups"])
        saved = SavedTable(PaperTable(**fields | {"groups": groups}), Origin(**body["origin"]), body["walks"])
    except (OSError, ValueError, RecursionError, AttributeError, KeyError, TypeError, AssertionError):
        return None
    return saved if saved.table.name == name else None


def _row(fields: dict[str, Any]) -> PaperRow:
    verdict = fields["reproduces"]
    return PaperRow(**fields | {"reproduces": None if verdict is None else Verdict(verdict)})
