"""A measured table of a paper: rows in groups with a verdict each, its picture and files, and the page of all."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from quadlog.results.find_runs import refuse_existing
from quadlog.results.page import blocks
from quadlog.results.page.blocks import Cell, Column, Sentence, Table
from quadlog.results.page.pack import Pack
from quadlog.results.record import to_json
from quadlog.results.text import State, TitledTable, count, ends_text, print_table, print_tables, sig
from quadlog.results.view import Panel, Spread, forest
from quadlog.storage.atomic_write import write_whole, writing


class Verdict(StrEnum):
    """Whether what a paper prints reproduces.

    undecided: our interval holds both what the paper prints and its contrary. not comparable: the paper does not say
    how its number came about, ours rests on that very number or on two walks, or holds by construction.
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
        clear = {claim: of & {Verdict.YES, Verdict.NO} or of & {Verdict.UNDECIDED} or of for claim, of in found.items()}
        return {claim: next(iter(of)) if len(of) == 1 else Verdict.UNDECIDED for claim, of in clear.items()}

    @property
    def reproduced(self) -> str:
        """How many of the claims reproduce, in words."""
        counts, words = Counter(self.claims.values()), {Verdict.YES: "reproduce", Verdict.NO: "do not"}
        parts = [f"{counts[verdict]} {words.get(verdict, verdict)}" for verdict in Verdict if counts[verdict]]
        claims = f"{counts.total()} claim{'s' * (counts.total() != 1)}"
        return f"{claims}: {', '.join(parts)}" if parts else "the paper prints none"

    @property
    def command(self) -> str:
        """The command line that makes this table."""
        fast, seed = " --fast" if self.fast else "", f" --seed {self.seed}" if self.seed else ""
        return f"quadlog tables {self.name}{fast}{seed}"


COLORS = {Verdict.YES: "robot", Verdict.NO: "target", Verdict.UNDECIDED: "note"}
MOST, HEAD, TAIL = 10.0, 42, 18
"""What lies farther off stands at the edge. Letters at the beginning and end of a long name that are kept."""
AXIS = "ours less print or claim, in half-widths of our interval"


def table_panel(table: PaperTable) -> Panel | None:
    """How far ours lies from what the paper prints or says, in widths of our interval, by row; None without any."""
    rows: dict[str, Spread] = {}
    for row in table.rows:
        if (spread := _spread(row)) is not None:
            name = row.quantity.rpartition(" (")[0]
            label = name if len(name) <= HEAD + TAIL else f"{name[:HEAD]}…{name[-TAIL:]}"
            rows[row.quantity if label in rows else label] = spread
    return forest(table.name, rows, AXIS, marks={"as printed": 0.0}) if rows else None


def _spread(row: PaperRow) -> Spread | None:
    printed = row.paper
    if printed is None and row.claim[:1] in ("<", ">"):
        printed = float(row.claim[1:])
    if row.reproduces not in COLORS or row.low is None or row.high is None or printed is None or row.low == row.high:
        return None
    places = (np.array([row.ours, row.low, row.high]) - printed) / ((row.high - row.low) / 2)
    ours, low, high = np.clip(places, -MOST, MOST).tolist()
    return Spread(ours, (low, high), color=COLORS[row.reproduces])


PAGE, SUFFIXES = "report.html", ("csv", "tex", "png", "json")
COLUMNS = ("quantity", "paper", "ours", "low", "high", "difference", "reproduces", "note")
SHOWN = ("quantity", "paper", "ours", "95 % interval", "difference", "reproduces")


def csv_text(table: PaperTable) -> str:
    """All rows in full precision, an empty field where there is no value."""
    return print_table(COLUMNS, [[getattr(row, name) for name in COLUMNS] for row in table.rows], "csv")


def latex_text(table: PaperTable) -> str:
    """A table of each group, without the notes."""
    fast = " (fast run)" if table.fast else ""
    titled = ((f"{table.title}: {of.title}{fast}", [*map(shown_cells, of.rows)]) for of in table.groups)
    return print_tables([TitledTable(title, SHOWN, rows) for title, rows in titled], "latex", [table.command])


def shown_cells(row: PaperRow) -> tuple[str, ...]:
    """A row as people read it, in the order of SHOWN, with four significant digits."""
    ends = None if row.low is None or row.high is None else (row.low, row.high)
    paper, difference = ("" if of is None else sig(of, 4) for of in (row.paper, row.difference))
    printed = (row.claim, "") if row.claim else (paper, difference)
    return row.quantity, printed[0], sig(row.ours, 4), ends_text(ends, 4), printed[1], row.reproduces or ""


def prepare_folder(folder: Path, names: Sequence[str], force: bool) -> None:
    """Make the folder, before the named tables are measured.

    Raises CannotWrite, and unless `force` AlreadyExists for the page and for a file of theirs.
    """
    for name in (PAGE, *(f"{name}.{suffix}" for name in names for suffix in SUFFIXES)):
        refuse_existing(folder / name, force)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)


def write_table(folder: Path, table: PaperTable, walks: Sequence[Mapping[str, Any]]) -> None:
    """CSV, LaTeX, JSON and, where something can be compared, a picture; walks: rows of factors and figures."""
    from quadlog.results.mpl import render  # slow to import

    content = {"table": asdict(table), "walks": walks}
    files = {"csv": csv_text(table).encode(), "tex": latex_text(table).encode(), "json": to_json(content)}
    if (panel := table_panel(table)) is not None:
        files["png"] = render([panel])
    for suffix, written in files.items():
        write_whole(folder / f"{table.name}.{suffix}", written)


LOOKS: dict[Verdict, tuple[str, State, str]] = {
    Verdict.NO: ("Do not", "bad", "print and ours are not of one kind, or ours is beyond the claim; a note says why"),
    Verdict.UNDECIDED: ("Undecided", "warn", "our interval holds it and its contrary, or settings disagree"),
    Verdict.YES: ("Reproduce", "good", "our interval holds the number and not its contrary, or is on the claim's side"),
    Verdict.NOT_COMPARABLE: ("Not comparable", "", "of unknown origin, of two walks, or by construction"),
}  # fmt: skip
"""Word, colour and rule of each verdict, worst first."""


def papers_page(tables: Sequence[PaperTable]) -> blocks.Page:
    """The page of these tables."""
    verdicts, pack = [verdict for table in tables for verdict in table.claims.values()], Pack()
    findings = [
        Sentence(word, f"{number} of {len(verdicts)} claims: {rule}.", state)
        for verdict, (word, state, rule) in LOOKS.items()
        if (number := verdicts.count(verdict))
    ]
    facts = [
        f"{count(len(tables))} table{'s' * (len(tables) != 1)}",
        f"{count(len(verdicts))} printed numbers and claims, counted once for all settings",
        "errata: docs/errata.md",
    ]
    first = blocks.Section("", [blocks.Verdict(findings), _overview(tables)])
    sections = [first, *(_section(table, pack) for table in tables)]
    return blocks.Page("The papers' tables, measured again", sections, facts, pack=pack)


def _overview(tables: Sequence[PaperTable]) -> Table:
    columns = [Column("table"), Column("of", wide=True), *(Column(str(verdict), True) for verdict in LOOKS)]
    rows = []
    for table in tables:
        verdicts = [*table.claims.values()]
        counts = [(verdicts.count(verdict), state) for verdict, (_, state, _) in LOOKS.items()]
        cells = [Cell(str(number) if number else "", number, state=state) for number, state in counts]
        rows.append([Cell(table.name, href=f"#{table.name}"), Cell(table.title), *cells, Cell(str(len(table.rows)))])
    return Table([*columns, Column("quantities", True)], rows, "tables")


LEGEND = "Ours with 95 % intervals, in the colour of the verdict; 0 is the printed value or claim, ±10 the edge."


def _section(table: PaperTable, pack: Pack) -> blocks.Section:
    files = f"{table.name}.csv, {table.name}.tex and {table.name}.json"
    fast = " (a fast run, with wider intervals)" if table.fast else ""
    words = f"{table.reproduced}. {table.sizes} Made by {table.command}{fast}; also as {files}."
    shown: list[Any] = [blocks.Text(words)]
    shown += [_group(group, f"{table.name}-{number}") for number, group in enumerate(table.groups)]
    if (panel := table_panel(table)) is not None:
        pack.add(f"{table.name}-picture", [panel])
        shown.append(blocks.Drawn(f"{table.name}-picture", "Beside the printed numbers", LEGEND))
    return blocks.Section(table.name, shown, f"{table.title}. {table.caption}".replace("`", ""))


def _group(group: RowGroup, name: str) -> Table:
    """What the paper has first; other quantities on demand."""
    rows = sorted(group.rows, key=lambda row: row.paper is None and row.reproduces is None)
    judged = sum(row.paper is not None or row.reproduces is not None for row in rows)
    columns = [Column("quantity"), Column("paper", True), Column("ours", True), Column("95 % interval", True),
               Column("reproduces"), Column("note", wide=True)]  # fmt: skip
    folded = judged if judged < len(rows) else None
    return Table(columns, [*map(_row, rows)], name, group.text, folded=folded, title=group.title)


def _row(row: PaperRow) -> list[Cell]:
    quantity, paper, ours, interval, _, reproduces = shown_cells(row)
    state: State = "" if row.reproduces is None else LOOKS[row.reproduces][1]
    numbers = [Cell(paper, row.paper), Cell(ours, row.ours), Cell(interval)]
    return [Cell(quantity), *numbers, Cell(str(reproduces), state=state), Cell(row.note)]
