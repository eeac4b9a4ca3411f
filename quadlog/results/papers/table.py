"""A measured table of a paper: rows in groups, pictures, and how it was measured; saved and loaded."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any


class Verdict(StrEnum):
    """Whether what a paper prints reproduces.

    undecided: our interval holds both what the paper prints and its contrary. not comparable: the paper does not say
    how its number came about, or ours rests on that very number.
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
    """

    quantity: str
    ours: float
    paper: float | None = None
    low: float | None = None
    high: float | None = None
    reproduces: Verdict | None = None
    note: str = ""
    claim: str = ""

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
class TablePicture:
    """A PNG of a table. name: stem of the file; alt: text for readers who cannot see it; caption: how to read it."""

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
    pictures: tuple[TablePicture, ...] = ()
    errata: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        quantities = [row.quantity for row in self.rows]
        assert len(set(quantities)) == len(quantities), "a quantity names its row in the CSV file"

    @property
    def rows(self) -> tuple[PaperRow, ...]:
        """The rows of all groups, in order."""
        return tuple(row for group in self.groups for row in group.rows)

    def count(self, verdict: Verdict) -> int:
        """Rows with this verdict."""
        return sum(row.reproduces is verdict for row in self.rows)

    @property
    def comparable(self) -> int:
        """Rows that reproduce, do not, or are undecided."""
        return sum(map(self.count, (Verdict.YES, Verdict.NO, Verdict.UNDECIDED)))

    @property
    def reproduced(self) -> str:
        """How many of what the paper prints, in words."""
        if not any(map(self.count, Verdict)):
            return "the paper prints none"
        others = [f"{self.count(each)} {each}" for each in (Verdict.UNDECIDED, Verdict.NOT_COMPARABLE)]
        others = [each for each in others if not each.startswith("0 ")]
        return ", ".join([f"{self.count(Verdict.YES)} of {self.comparable} printed numbers reproduce", *others])

    @property
    def command(self) -> str:
        """The command line that makes this table."""
        fast, seed = " --fast" if self.fast else "", f" --seed {self.seed}" if self.seed else ""
        return f"quadlog tables {self.name}{fast}{seed}"


LARGEST_BYTES = 16_000_000
"""No more is read of a file; no table comes near."""


@dataclass(frozen=True, slots=True)
class Origin:
    """What the content of a table depends on. code: digest of quadlog and its packages; fast, seed: as requested.

    A table without random draws has fast False and seed 0 itself, whatever was requested.
    """

    code: str
    fast: bool
    seed: int


@dataclass(frozen=True, slots=True)
class SavedTable:
    """A table in a folder, and its origin."""

    table: PaperTable
    origin: Origin


def picture_file(table: PaperTable, picture: TablePicture) -> str:
    """File name of a picture."""
    return f"{table.name}-{picture.name}.png"


def json_bytes(saved: SavedTable) -> bytes:
    """The table as JSON with a SHA-256 of itself; pictures are replaced by their SHA-256."""
    table = asdict(saved.table)
    for picture in table["pictures"]:
        picture["sha256"] = hashlib.sha256(picture.pop("png")).hexdigest()
    body = {"origin": asdict(saved.origin), "table": table}
    return (json.dumps(body | {"sha256": _digest(body)}, indent=1, ensure_ascii=False) + "\n").encode()


def load_saved(folder: Path, name: str) -> SavedTable | None:
    """The table saved in a folder; None if it is missing, incomplete or damaged."""
    try:
        with (folder / f"{name}.json").open("rb") as stream:
            body = json.loads(stream.read(LARGEST_BYTES))
        if body.pop("sha256") != _digest(body) or body["table"]["name"] != name:
            return None
        return SavedTable(_table(folder, body["table"]), Origin(**body["origin"]))
    except (OSError, ValueError, RecursionError, AttributeError, KeyError, TypeError, AssertionError):
        return None


def _digest(body: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


def _table(folder: Path, fields: dict[str, Any]) -> PaperTable:
    """Raises the errors that `load_saved` handles."""
    groups = tuple(
        RowGroup(group["title"], group["text"], tuple(map(_row, group["rows"]))) for group in fields.pop("groups")
    )
    pictures = tuple(_picture(folder, fields["name"], each) for each in fields.pop("pictures"))
    return PaperTable(**fields | {"errata": tuple(fields["errata"])}, groups=groups, pictures=pictures)


def _row(fields: dict[str, Any]) -> PaperRow:
    verdict = fields.pop("reproduces")
    return PaperRow(**fields, reproduces=None if verdict is None else Verdict(verdict))


def _picture(folder: Path, name: str, fields: dict[str, Any]) -> TablePicture:
    """Raises ValueError if the picture's file has changed."""
    sha256 = fields.pop("sha256")
    # Only files of this folder: a damaged name must not lead elsewhere.
    files = {path.name: path for path in folder.glob(f"{name}-*.png")}
    png = files[f"{name}-{fields['name']}.png"].read_bytes()
    if hashlib.sha256(png).hexdigest() != sha256:
        raise ValueError(name)
    return TablePicture(**fields, png=png)
